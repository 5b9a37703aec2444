"""The stage that says what code each sign of a drive bears, by Bayes' theorem over the catalogue.

The probability of a code given colour, shape, size and the pixels of the face is in proportion to how common it is and
to the probability of each of these given the code; they are taken as independent. The system, US or Vienna, is one
unknown of the whole drive: what all signs say of it together is the prior of each. What is settled is stated: the code
with its legend, else the code, else the series, else nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.landmarks import Landmark
from wayside.schemas.settings import CodeSettings
from wayside.schemas.sign_catalogue import (
    CATALOGUE,
    INCH_M,
    SERIES,
    SYSTEMS,
    UNIT_M,
    CatalogueSign,
    Size,
)
from wayside.schemas.signs import Sign, SignCode
from wayside.stages.sign_codes.face_patches import OTHER_FACE


@dataclass(frozen=True, slots=True)
class _Leaf:
    """One legend of a catalogue sign.

    face: its class of the face classifier; nodes: what may be stated of it, from the widest to the narrowest; extents
    (k, 2): of its standard sizes, or of its limits, metres; share: of the signs of its system.
    """

    sign: CatalogueSign
    face: str
    nodes: tuple[str, ...]
    extents: NDArray[np.float64]
    share: float


def assign_codes(
    signs: Iterator[Sign], *, settings: CodeSettings, classes: tuple[str, ...] = ()
) -> Iterator[Sign]:
    """Give every sign its code as far as it is settled, and the probability that the drive is of the US system.

    Parameters
    ----------
    signs
        All signs of the drive, with their final sizes.
    settings
        The system, and what is settled.
    classes
        Of the face classifier, in the order of `Landmark.face_log_probability`; empty without one.

    Yields
    ------
    The signs, in order, after the last one came.
    """
    listed = list(signs)
    leaves = {system: _leaves(system) for system in SYSTEMS}
    likelihoods = {
        system: [_likelihoods(sign, leaves[system], settings, classes) for sign in listed]
        for system in SYSTEMS
    }
    prior = system_probabilities(likelihoods, leaves, settings)
    for k, sign in enumerate(listed):
        yield replace(
            sign,
            code=_settled(sign, {s: likelihoods[s][k] for s in SYSTEMS}, leaves, prior, settings),
            us_probability=prior[SYSTEMS[0]],
        )


def system_probabilities(
    likelihoods: Mapping[str, Sequence[NDArray[np.float64]]],
    leaves: Mapping[str, Sequence[_Leaf]],
    settings: CodeSettings,
) -> dict[str, float]:
    """Probability of each system by all signs of a drive together; both alike where there is none."""
    if settings.system != "auto":
        return {system: float(system == settings.system) for system in SYSTEMS}
    odds = np.zeros(len(SYSTEMS))
    for k, system in enumerate(SYSTEMS):
        share = np.array([leaf.share for leaf in leaves[system]])
        for likelihood in likelihoods[system]:
            odds[k] += np.log((1 - settings.unlike) * (share @ likelihood) + settings.unlike)
    odds = np.exp(odds - odds.max())
    return dict(zip(SYSTEMS, (odds / odds.sum()).tolist(), strict=True))


def _leaves(system: str) -> tuple[_Leaf, ...]:
    total = sum(sign.weight for sign in CATALOGUE[system])
    found = []
    for sign in CATALOGUE[system]:
        faces = sign.faces or (OTHER_FACE,)
        extents = np.array([extent_m(sign, size, system) for size in sign.limits or sign.sizes])
        group = SERIES[system][sign.series][1]
        wider = [*([] if group is None else [group]), sign.series]
        for face in faces:
            _, _, legend = face.partition(" ")
            named = [] if sign.code == sign.series else [sign.code, f"{sign.code} {legend}"]
            nodes = (*wider, *(named if legend else named[:1]))
            found.append(_Leaf(sign, face, nodes, extents, sign.weight / total / len(faces)))
    return tuple(found)


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


def _likelihoods(
    sign: Sign, leaves: Sequence[_Leaf], settings: CodeSettings, classes: tuple[str, ...]
) -> NDArray[np.float64]:
    """Likelihood (leaves,) of what was measured of a sign, over that of a sign like nothing in the catalogue."""
    landmark = sign.landmark
    color = _ratios(landmark.color, landmark.color_log_probability, COLORS, settings)
    shape = _ratios(landmark.shape, landmark.shape_log_probability, SHAPES, settings)
    faces = _face_ratios(landmark, classes, settings)
    other, odd = faces.get(OTHER_FACE, 1.0), settings.odd_size
    return np.array(
        [
            np.mean([color[name] for name in leaf.sign.colors])
            * np.mean([shape[name] for name in leaf.sign.shapes])
            * ((1 - odd) * _size_ratio(sign, leaf, settings) + odd)
            * faces.get(leaf.face, other)
            for leaf in leaves
        ]
    )


def _ratios(
    named: str | None,
    log_probability: tuple[float, ...],
    names: tuple[str, ...],
    settings: CodeSettings,
) -> dict[str, float]:
    """Likelihood of what was seen by class, over that of all classes alike; 1 where nothing was."""
    if log_probability:
        probability = np.exp(np.array(log_probability) - np.logaddexp.reduce(log_probability))
        return dict(zip(names, (len(names) * probability).tolist(), strict=True))
    if named is None:
        return dict.fromkeys(names, 1.0)
    wrong = (1 - settings.named_right) / (len(names) - 1)
    return {name: len(names) * (settings.named_right if name == named else wrong) for name in names}


def _face_ratios(
    landmark: Landmark, classes: tuple[str, ...], settings: CodeSettings
) -> dict[str, float]:
    """Likelihood of the pixels by class of face, over that of all alike; empty where the face was not classified."""
    if not landmark.face_log_probability:
        return {}
    other = settings.other_share
    each = (1 - other) / (len(classes) - 1)
    return {
        name: (1 - settings.misread) * float(np.exp(value)) / (other if name == OTHER_FACE else each)
        + settings.misread
        for name, value in zip(classes, landmark.face_log_probability, strict=True)
    }  # fmt: skip


def _size_ratio(sign: Sign, leaf: _Leaf, settings: CodeSettings) -> float:
    """Density of the measured size, over that of a panel of any size."""
    size = np.array([sign.width_m, sign.height_m])
    if not (np.isfinite(size).all() and (size > 0).all()):
        return 1.0
    broad = 1 / np.log(settings.largest_side_m / settings.smallest_side_m) ** 2
    if leaf.sign.limits is not None:
        low, high = leaf.extents
        inside = ((size >= low) & (size <= high)).all()
        return float(inside / np.log(high / low).prod() / broad)
    deviation, sigma = _off_standard(sign, leaf.extents, settings)
    density = np.exp(-(deviation**2).sum(axis=1) / 2) / (2 * np.pi * sigma.prod(axis=1))
    return float(density.mean() * size.prod() / broad)


def _off_standard(
    sign: Sign, extents: NDArray[np.float64], settings: CodeSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far the measured size is from standard ones (k, 2), in standard deviations, and these, metres."""
    measured = np.nan_to_num([sign.sigma_width_m, sign.sigma_height_m], nan=0.0)
    sigma = np.hypot(measured, settings.size_tolerance * extents)
    return (np.array([sign.width_m, sign.height_m]) - extents) / sigma, sigma


def _settled(
    sign: Sign,
    likelihoods: Mapping[str, NDArray[np.float64]],
    leaves: Mapping[str, Sequence[_Leaf]],
    prior: Mapping[str, float],
    settings: CodeSettings,
) -> SignCode | None:
    """The narrowest statement whose probability is large enough; None where there is none."""
    foreign = settings.foreign if settings.system == "auto" else 0.0
    # what each leaf of both systems explains, and what nothing in the catalogue does
    explained: list[tuple[str, _Leaf, float]] = []
    for system in SYSTEMS:
        own = foreign + (1 - 2 * foreign) * prior[system]
        weights = own * (1 - settings.unlike) * likelihoods[system]
        explained += [
            (system, leaf, leaf.share * weight)
            for leaf, weight in zip(leaves[system], weights.tolist(), strict=True)
        ]
    total = settings.unlike + sum(weight for _, _, weight in explained)
    nodes: dict[tuple[int, str, str], float] = {}
    for system, leaf, weight in explained:
        for depth, node in enumerate(leaf.nodes):
            key = (depth, system, node)
            nodes[key] = nodes.get(key, 0.0) + weight / total
    settled = [key for key, probability in nodes.items() if probability >= settings.settled]
    if not settled:
        return None
    depth, system, narrowest = max(settled)
    code, _, legend = narrowest.partition(" ")
    may_be = [
        (leaf, weight / total)
        for of, leaf, weight in explained
        if of == system and narrowest in leaf.nodes
    ]
    probability = nodes[depth - 1 if legend else depth, system, code]
    nominal = nominal_size_in(sign, may_be, system, settings)
    return SignCode(system, code, legend or None, probability, nominal)


def nominal_size_in(
    sign: Sign, leaves: Sequence[tuple[_Leaf, float]], system: str, settings: CodeSettings
) -> Size | None:
    """The standard size, inches, that the measured one can be; None where none or several can.

    leaves: what the sign may be, with the probability of each.
    """
    likely: dict[Size, float] = {}
    for leaf, probability in leaves:
        if leaf.sign.limits is not None:
            continue
        off, sigma = _off_standard(sign, leaf.extents, settings)
        density = np.exp(-(off**2).sum(axis=1) / 2) / sigma.prod(axis=1)
        density = np.where((np.abs(off) <= settings.size_sigmas).all(axis=1), density, 0.0)
        if density.any():
            for size, share in zip(leaf.sign.sizes, density / density.sum(), strict=True):
                likely[size] = likely.get(size, 0.0) + probability * float(share)
    best = max(likely, key=lambda size: likely[size], default=None)
    if best is None or likely[best] < settings.settled * sum(likely.values()):
        return None
    width, height = (round(side * UNIT_M[system] / INCH_M, 2) for side in best)
    return width, height
