"""The stage that determines the code of each sign of a drive, by Bayes' theorem over the catalogue.

The probability of a code is proportional to its frequency and to the probabilities of colour, shape, size and face
pixels given the code. They are taken as independent. The system, US or Vienna, is one unknown of the whole drive: what
all signs say of it together is the prior of each. The narrowest certain statement is made: the code with its legend,
else the code, else the series, else nothing. The category is stated wherever it is certain, also of a code that is not.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.landmarks import Landmark
from wayside.schemas.settings import CodeSettings
from wayside.schemas.sign_catalogue import (
    CATALOGUE,
    CATEGORIES,
    INCH_M,
    SYSTEMS,
    UNIT_M,
    CatalogueSign,
    Size,
    stated,
)
from wayside.schemas.signs import Sign, SignCode
from wayside.stages.sign_codes.face_classes import OTHER_FACE

FOREIGN = 0.01
"""Share of signs of the other system on a drive (estimate): at borders, on private ground, copied ones."""
SIZE_TOLERANCE = 0.03
"""Relative scatter of a face's extent about its nominal size: a diamond of 30 in is 40.9 in wide, not 42.4."""
NAMED_RIGHT = 0.9
"""Probability that a colour or shape is right where no network states it (estimate)."""
UNLIKE = 0.01
"""Probability that a sign is like nothing in the catalogue: bounds what it says of the system (estimate)."""
ODD_SIZE = 0.1
"""Probability that a sign has none of the sizes of its code, or was measured wrong (estimate)."""
MISREAD = 0.11
"""Probability that the face classifier is wrong, as on held-out tracks: it bounds what the pixels say."""
OTHER_SHARE = 0.1
"""Share of faces of no code among those that the face classifier was taught by `make learn-faces`."""
SMALLEST_SIDE_M = 0.1
"""Smallest side that a panel of no standard size may have; sides are log-uniform."""
LARGEST_SIDE_M = 8.0
"""Largest side of such a panel."""


Floats = NDArray[np.float64]


class _Leaf(NamedTuple):
    """One legend of a catalogue sign, by its number in `_SIGNS`.

    `face`: its class of the face classifier. `nodes`: what may be stated of it, from the widest to the narrowest.
    `share`: of the signs of its system.
    """

    sign: int
    system: str
    face: str
    category: str
    nodes: tuple[str, ...]
    share: float


def extent_m(sign: CatalogueSign, size: Size, system: str) -> tuple[float, float]:
    """Width and height of the face of a sign of a nominal size, metres."""
    width, height = (side * UNIT_M[system] for side in size)
    if sign.shapes == ("diamond",):
        return width * math.sqrt(2), height * math.sqrt(2)
    if sign.shapes == ("triangle",):
        return width, height * math.sqrt(3) / 2
    if sign.shapes == ("pennant",):
        return math.sqrt(width**2 - (height / 2) ** 2), height
    if sign.shapes == ("crossbuck",):
        return ((width + height) / math.sqrt(2),) * 2
    return width, height


def _leaves() -> Iterator[_Leaf]:
    for number, (system, sign) in enumerate(_SIGNS):
        faces = sign.faces or (OTHER_FACE,)
        share = sign.weight / sum(one.weight for one in CATALOGUE[system]) / len(faces)
        for face in faces:
            category, *nodes = stated(system, sign.code, face.partition(" ")[2])
            yield _Leaf(number, system, face, category, tuple(nodes), share)


_SIGNS = tuple((system, sign) for system in SYSTEMS for sign in CATALOGUE[system])
_LEAVES = tuple(_leaves())
_SIZES = tuple((k, size) for k, (_, sign) in enumerate(_SIGNS) for size in sign.sizes)
"""Standard sizes, each with the number of its sign."""
_SIGN_OF_LEAF = np.array([leaf.sign for leaf in _LEAVES])
_CATEGORY_OF_LEAF = np.array([CATEGORIES.index(leaf.category) for leaf in _LEAVES])
_SIGN_OF_SIZE = np.array([k for k, _ in _SIZES])
_EXTENTS = np.array([extent_m(_SIGNS[k][1], size, _SIGNS[k][0]) for k, size in _SIZES])
_LIMITS = {
    k: np.array([extent_m(sign, size, system) for size in sign.limits])
    for k, (system, sign) in enumerate(_SIGNS)
    if sign.limits is not None
}
_COLOR_SHARES = np.array([[(c in s.colors) / len(s.colors) for c in COLORS] for _, s in _SIGNS])
_SHAPE_SHARES = np.array([[(c in s.shapes) / len(s.shapes) for c in SHAPES] for _, s in _SIGNS])
_LEAF_SHARES = {
    system: np.array([leaf.share * (leaf.system == system) for leaf in _LEAVES])
    for system in SYSTEMS
}


def assign_codes(
    signs: Iterator[Sign], *, settings: CodeSettings, classes: tuple[str, ...] = ()
) -> Iterator[Sign]:
    """Give every sign its code as far as it is certain, and the probability that the drive is of the US system.

    Yields the signs, which have their final sizes, in order, after the last one came. `classes`: of the face
    classifier, in the order of `Landmark.face_log_probability`; empty without one.
    """
    listed = list(signs)
    likelihoods = [_likelihoods(sign, classes) for sign in listed]
    prior = system_probabilities(likelihoods, settings)
    for sign, likelihood in zip(listed, likelihoods, strict=True):
        explained = _explained(likelihood, prior, settings)
        of_category = np.bincount(_CATEGORY_OF_LEAF, explained)
        category = CATEGORIES[of_category.argmax()]
        yield replace(
            sign,
            code=_settled(sign, explained, settings),
            category=category if of_category.max() >= settings.settled else None,
            us_probability=prior[SYSTEMS[0]],
        )


def system_probabilities(likelihoods: Sequence[Floats], settings: CodeSettings) -> dict[str, float]:
    """Probability of each system by all signs of a drive together, equal without signs."""
    if settings.system != "auto":
        return {system: float(system == settings.system) for system in SYSTEMS}
    odds = np.zeros(len(SYSTEMS))
    for likelihood in likelihoods:
        fits = np.array([share @ likelihood for share in _LEAF_SHARES.values()])
        odds += np.log((1 - UNLIKE) * fits + UNLIKE)
    odds = np.exp(odds - odds.max())
    return dict(zip(SYSTEMS, (odds / odds.sum()).tolist(), strict=True))


def _likelihoods(sign: Sign, classes: tuple[str, ...]) -> Floats:
    """Likelihood (leaves,) of what was measured of a sign, over that of a sign like nothing in the catalogue."""
    landmark = sign.landmark
    color = _ratios(landmark.color, landmark.color_log_probability, COLORS)
    shape = _ratios(landmark.shape, landmark.shape_log_probability, SHAPES)
    faces = _face_ratios(landmark, classes)
    size = (1 - ODD_SIZE) * _size_ratios(sign) + ODD_SIZE
    fits = (_COLOR_SHARES @ color) * (_SHAPE_SHARES @ shape) * size
    other = faces.get(OTHER_FACE, 1.0)
    return np.asarray(fits[_SIGN_OF_LEAF] * [faces.get(leaf.face, other) for leaf in _LEAVES])


def _ratios(named: str | None, log_probability: Sequence[float], names: tuple[str, ...]) -> Floats:
    """Likelihood (classes,) of what was seen, over that of all classes alike; 1 where nothing was."""
    if log_probability:
        scaled = np.array(log_probability) - np.logaddexp.reduce(log_probability)
        known = len(scaled) * np.exp(scaled)
        return np.pad(known, (0, len(names) - len(known)))  # no network takes it for another class
    if named is None:
        return np.ones(len(names))
    wrong = (1 - NAMED_RIGHT) / (len(names) - 1)
    return len(names) * np.where(np.array(names) == named, NAMED_RIGHT, wrong)


def _face_ratios(landmark: Landmark, classes: tuple[str, ...]) -> dict[str, float]:
    """Likelihood of the pixels by class of face, over that of all alike; empty where the face was not classified."""
    if not landmark.face_log_probability:
        return {}
    each = (1 - OTHER_SHARE) / (len(classes) - 1)
    return {
        name: (1 - MISREAD) * float(np.exp(value)) / (OTHER_SHARE if name == OTHER_FACE else each)
        + MISREAD
        for name, value in zip(classes, landmark.face_log_probability, strict=True)
    }  # fmt: skip


def _size_ratios(sign: Sign) -> Floats:
    """Density (signs of the catalogue,) of the measured size, over that of a panel of any size."""
    size = np.array([sign.width_m, sign.height_m])
    if not (np.isfinite(size).all() and (size > 0).all()):
        return np.ones(len(_SIGNS))
    broad = 1 / np.log(LARGEST_SIDE_M / SMALLEST_SIDE_M) ** 2
    _, density = _off_standard(sign)
    counts = np.maximum(np.bincount(_SIGN_OF_SIZE, minlength=len(_SIGNS)), 1)
    mean = np.bincount(_SIGN_OF_SIZE, density, minlength=len(_SIGNS)) / counts
    ratio = mean / (2 * np.pi) * size.prod() / broad
    for k, (low, high) in _LIMITS.items():
        inside = ((size >= low) & (size <= high)).all()
        ratio[k] = inside / np.log(high / low).prod() / broad
    return np.asarray(ratio)


def _off_standard(sign: Sign) -> tuple[Floats, Floats]:
    """How far the measured size is from the standard ones, in standard deviations (k, 2), and its density (k,)."""
    measured = np.nan_to_num([sign.sigma_width_m, sign.sigma_height_m], nan=0.0)
    sigma = np.hypot(measured, SIZE_TOLERANCE * _EXTENTS)
    off = (np.array([sign.width_m, sign.height_m]) - _EXTENTS) / sigma
    return off, np.exp(-(off**2).sum(axis=1) / 2) / sigma.prod(axis=1)


def _explained(likelihood: Floats, prior: dict[str, float], settings: CodeSettings) -> Floats:
    """Probability (leaves,) of each leaf of both systems; the rest is what nothing in the catalogue explains."""
    foreign = FOREIGN if settings.system == "auto" else 0.0
    shares = sum((foreign + (1 - 2 * foreign) * prior[s]) * _LEAF_SHARES[s] for s in SYSTEMS)
    explained = shares * (1 - UNLIKE) * likelihood
    return np.asarray(explained / (UNLIKE + explained.sum()))


def _settled(sign: Sign, explained: Floats, settings: CodeSettings) -> SignCode | None:
    """The narrowest statement whose probability is large enough, or None."""
    nodes: dict[tuple[int, str, str], float] = {}
    for leaf, probability in zip(_LEAVES, explained.tolist(), strict=True):
        for depth, node in enumerate(leaf.nodes):
            key = (depth, leaf.system, node)
            nodes[key] = nodes.get(key, 0.0) + probability
    settled = [key for key, probability in nodes.items() if probability >= settings.settled]
    if not settled:
        return None
    depth, system, narrowest = max(settled)
    code, _, legend = narrowest.partition(" ")
    may_be = [leaf.system == system and narrowest in leaf.nodes for leaf in _LEAVES]
    probability = nodes[depth - 1 if legend else depth, system, code]
    nominal = nominal_size_in(sign, np.where(may_be, explained, 0.0), system, settings)
    return SignCode(system, code, legend or None, probability, nominal)


def nominal_size_in(
    sign: Sign, probability: Floats, system: str, settings: CodeSettings
) -> Size | None:
    """The standard size, inches, that the measured one can be; None where none or several can.

    `probability` (leaves,): that the sign is each of them, 0 of another system.
    """
    off, density = _off_standard(sign)
    density = np.where((np.abs(off) <= settings.size_sigmas).all(axis=1), density, 0.0)
    total = np.bincount(_SIGN_OF_SIZE, density, minlength=len(_SIGNS))
    by_sign = np.bincount(_SIGN_OF_LEAF, probability, minlength=len(_SIGNS))
    likely: dict[Size, float] = {}
    for (k, size), value in zip(_SIZES, density.tolist(), strict=True):
        if value > 0 and by_sign[k] > 0:
            likely[size] = likely.get(size, 0.0) + float(by_sign[k] * value / total[k])
    best = max(likely, key=lambda size: likely[size], default=None)
    if best is None or likely[best] < settings.settled * sum(likely.values()):
        return None
    width, height = (round(side * UNIT_M[system] / INCH_M, 2) for side in best)
    return width, height
