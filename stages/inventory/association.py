"""Which sightings of different drives may be of one panel: position, facing and face, as log-likelihood ratios."""

from math import lgamma, log, pi, radians

import numpy as np
from scipy.spatial import cKDTree

from wayside.schemas.settings.merging import MergeSettings
from wayside.schemas.sightings import Floats, Ints, Sightings

NEAR_SIGMAS = 4.0
"""Sightings farther apart, by their errors, are two: of normal errors one pair in 16,000 lies beyond."""
SAME_PROBABILITY = 0.9999
"""Chi-square (3) bound on sightings of one panel that tell of offsets: far pairs say nothing."""
FACING_DEG = 45.0
"""Faces that look in directions farther apart are two panels: more than scatter, less than back to back."""
TAIL_FREEDOM = 5.0
"""Degrees of freedom of a position's Student distribution: one error in a hundred is four times as large."""
DENSITY = 0.02
"""Other panels around a panel, 1/m^3: one more within 50 m^3, panels on one support."""
_SCALE = lgamma((TAIL_FREEDOM + 3) / 2) - lgamma(TAIL_FREEDOM / 2) - 1.5 * log(TAIL_FREEDOM * pi)
PLACE_TERM = _SCALE - log(DENSITY)
"""Term of `place_log_ratio` that no measurement changes."""
MISREAD = 0.03
"""Probability that a drive gives a face another colour; the same of shape, size and code (judgement)."""
SAME_BY_CHANCE = 0.3
"""Probability that two panels have one colour by chance; the same of the shape: three kinds in equal parts."""
AGREE, DIFFER = log((1 - MISREAD) / SAME_BY_CHANCE), log(MISREAD / (1 - SAME_BY_CHANCE))
"""Log-likelihood ratio of equal and of different colours, for one panel against two; the same for shapes."""
SIZE_FLOOR = 0.05
"""Smallest relative standard deviation of a width or height (rendered drives held out)."""
MOST_CHANGED = 0.5
"""Largest probability of a change, however long ago: then the face says nothing of the place."""

YEAR_NS = 365.25 * 86_400e9


def candidate_pairs(
    sightings: Sightings, settings: MergeSettings, position: Floats | None = None
) -> Ints:
    """Pairs (m, 2) of rows of different drives, the lower first, near each other and facing the same way.

    Near: within `NEAR_SIGMAS` standard deviations of the errors of both, level, and at most within `reach_m`.
    `position` (n, 3): to compare instead of that measured.
    """
    where = sightings.position if position is None else position
    spread = sightings.common_sigma_m[:, 0]
    own = np.sqrt(sightings.covariance[:, [0, 1], [0, 1]].max(axis=1, initial=0.0))
    around = NEAR_SIGMAS * np.hypot(spread, own)
    radius = min(settings.reach_m, float(np.hypot(1, 1) * around.max(initial=0.0)))
    pairs = facing_pairs(sightings, where, radius)
    i, j = pairs.T
    near = np.linalg.norm(where[i, :2] - where[j, :2], axis=1) <= np.hypot(around[i], around[j])
    return np.asarray(pairs[near])


def facing_pairs(sightings: Sightings, where: Floats, radius_m: float) -> Ints:
    """Pairs (m, 2) of rows of different drives, the lower first, that face one way.

    They lie at `where` (n, 3), within a radius of each other on the level.
    """
    found = cKDTree(where[:, :2]).query_pairs(radius_m, output_type="ndarray")
    pairs = np.sort(np.asarray(found, np.int64).reshape(-1, 2), axis=1)
    i, j = pairs.T
    turn = np.abs(np.angle(np.exp(1j * (sightings.bearing_rad[i] - sightings.bearing_rad[j]))))
    apart = turn > radians(FACING_DEG)  # false where a bearing is unknown
    pairs = pairs[(sightings.drive[i] != sightings.drive[j]) & ~apart]
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def face_log_ratio(
    sightings: Sightings, i: Ints, j: Ints, agree: float = AGREE, differ: float = DIFFER
) -> Floats:
    """Log-likelihood ratio (m,) of the faces of rows i and j: of one panel, against of two by chance.

    What is unknown in either row says nothing, nor does the code where colour or shape differ already. `agree`,
    `differ`: what a colour, shape or code says.
    """
    ratio = size_log_ratio(sightings, i, j)
    differs = np.zeros(len(ratio), bool)
    for code in (sightings.color, sightings.shape, sightings.code):
        known = (code[i] >= 0) & (code[j] >= 0) & ~(differs & (code is sightings.code))
        ratio += np.where(known, np.where(code[i] == code[j], agree, differ), 0.0)
        differs |= known & (code[i] != code[j])
    return ratio


def size_log_ratio(sightings: Sightings, i: Ints, j: Ints) -> Floats:
    """Log-likelihood (m,) of two sizes against that of equal ones, not below that of a wrong measurement."""
    relative = np.hypot(sightings.size_sigma_m / sightings.size_m, SIZE_FLOOR)
    change = np.log(sightings.size_m[i] / sightings.size_m[j]) / np.hypot(relative[i], relative[j])
    ratio = np.maximum(-0.5 * np.square(change).sum(axis=1), log(MISREAD))
    return np.where(np.isfinite(ratio), ratio, 0.0)


def faces_log_ratio(sightings: Sightings, i: Ints, j: Ints, settings: MergeSettings) -> Floats:
    """Log-likelihood ratio (m,) of the faces of rows i and j at one place, against of two panels by chance.

    Either one face, or another one that was put up in its place between the two: what is seen then is as by chance.
    """
    replaced = np.maximum(changed_share(_years(sightings, i, j), settings), 1e-9)
    return np.logaddexp(np.log1p(-replaced) + face_log_ratio(sightings, i, j), np.log(replaced))


def miss_log_ratio(sightings: Sightings, i: Ints, j: Ints, settings: MergeSettings) -> Floats:
    """Log-likelihood ratio (m,) of what is not there: if rows i and j are two panels, each drive missed one of them.

    A drive that saw the front of its panel would also have seen a neighbour that faces the same way. The exceptions are
    that it missed the neighbour, or that the neighbour did not exist at the time. What is seen from behind is missed
    too often to tell.
    """
    replaced = changed_share(_years(sightings, i, j), settings)
    absent = np.minimum(settings.missed + replaced, 1.0)
    fronts = sightings.front[i].astype(np.int64) + sightings.front[j]
    return np.asarray(-np.log(absent) * fronts)


def gone_probability(
    confidence: float, years: float, looks: int, misses: int, settings: MergeSettings
) -> float:
    """Probability that a panel which one survey saw was not there in another, that looked and saw none.

    Otherwise either each of these drives missed it, by a vehicle in front or by its own fault, or it is no panel at
    all. The second is supported by other drives of the survey that should have seen it and did not.

    `confidence`: that it is a panel. `years`: between the surveys. `looks`: drives of the other survey that had the
    place in view. `misses`: drives of the same survey that had it in view and saw no panel.
    """
    changed = float(changed_share(np.array(years), settings))
    panel = confidence * settings.missed**misses
    gone, missed = panel * changed, panel * (1 - changed) * settings.missed**looks
    return gone / (gone + missed + 1 - confidence)


def changed_share(years: Floats, settings: MergeSettings) -> Floats:
    """Probability (n,) that a face is replaced, put up or taken down within years (n,)."""
    return np.minimum(settings.change_per_year * years, MOST_CHANGED)


def _years(sightings: Sightings, i: Ints, j: Ints) -> Floats:
    return np.asarray(np.abs(sightings.time_ns[i] - sightings.time_ns[j]) / YEAR_NS, np.float64)


def place_log_ratio(apart: Floats, spread: Floats) -> Floats:
    """Log-likelihood ratio (m,) of the places of two sightings: of one panel, against of one and its neighbour.

    `apart` (m, 3), `spread` (m, 3, 3): difference of two measurements, metres, and its covariance. For one panel it has
    a multivariate Student distribution, because some errors are larger than stated (Lange, Little and Taylor 1989).
    Neighbours that face the same way have the same density everywhere.
    """
    tail = (TAIL_FREEDOM + 3) * np.log1p(mahalanobis2(apart, spread) / TAIL_FREEDOM)
    return np.asarray(PLACE_TERM - 0.5 * (np.log(np.linalg.det(spread)) + tail))


def mahalanobis2(difference: Floats, covariance: Floats) -> Floats:
    """Squared Mahalanobis distances (m,) of differences (m, 3) with covariances (m, 3, 3)."""
    solved = np.linalg.solve(covariance, difference[..., None])[..., 0]
    return np.asarray(np.einsum("mi,mi->m", difference, solved))


def responsibilities(sightings: Sightings, i: Ints, j: Ints, score: Floats) -> Floats:
    """Probability (m,) that each pair is right among the pairs of its rows with the same two drives: one to one.

    The product of the two shares of a pair: among the pairs of row i, and among the pairs of row j. A pair without a
    rival has 1.
    """
    drives = int(sightings.drive.max(initial=0)) + 1
    result = np.ones(len(i))
    for one, other in ((i, j), (j, i)):
        key = np.unique(one * drives + sightings.drive[other], return_inverse=True)[1].ravel()
        highest = np.full(len(i), -np.inf)
        np.maximum.at(highest, key, score)
        likelihood = np.exp(score - highest[key])
        result *= likelihood / np.bincount(key, likelihood)[key]
    return result
