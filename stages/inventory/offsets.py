"""The error that all panels of a stretch of a drive share, from the panels that several drives have in common.

Along a drive this error is a first-order Gauss-Markov process: it has the standard deviation that the drive states for
its fixes, and the correlation time of their errors. Its value at every sighting is an unknown of one sparse
least-squares problem over all drives of an area. Pairs of sightings of one panel measure the difference of two of them.
The pairs are weighted again in every iteration (expectation maximisation, Granger and Pennec 2002). The kernel becomes
narrower meanwhile (graduated non-convexity with Geman and McClure weights, Blake and Zisserman 1987). Signs without a
similar neighbour decide first. The prior decides between arrangements that fit equally well.
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu
from scipy.special import chdtri

from wayside.schemas.settings.merging import MergeSettings
from wayside.schemas.sightings import Floats, Ints, Sightings
from wayside.stages.inventory.association import (
    SAME_PROBABILITY,
    candidate_pairs,
    face_log_ratio,
    mahalanobis2,
    responsibilities,
)

CORRELATION_S = 60.0
"""Correlation time of a drive's common error, usual for single receivers."""
KERNEL = (1.0, 0.5, 0.25, 0.1, 0.05, 0.0)
"""Kernel width of each iteration, by the common errors' sigma: wide first, so signs unlike their neighbours decide."""

_SHORTEST_S = 1e-3
"""Panels of one image share the error; a shorter step would make the matrix singular."""
_AXES = ((0, [0, 1]), (1, [2]))
"""Column of `common_sigma_m`, and the axes it holds for."""


def solve_offsets(sightings: Sightings, settings: MergeSettings) -> tuple[Floats, Ints]:
    """Common error (n, 3) of the drives at every sighting, metres, and the pairs (m, 2) that determined it.

    Each pair is of one panel. The error is zero where no panel is common to two drives.
    """
    offset = np.zeros((len(sightings), 3))
    pairs = candidate_pairs(sightings, settings)
    ratio = face_log_ratio(sightings, pairs[:, 0], pairs[:, 1])
    pairs, ratio = pairs[ratio > 0], ratio[ratio > 0]
    if not len(pairs):
        return offset, pairs
    i, j = pairs.T
    gate = float(chdtri(3, 1 - SAME_PROBABILITY))
    own = sightings.covariance[i] + sightings.covariance[j]
    common = np.square(sightings.common_sigma_m)[:, [0, 0, 1]]
    processes = [_process(sightings, sightings.common_sigma_m[:, column]) for column, _ in _AXES]
    for width in KERNEL:
        spread = own + width**2 * np.eye(3) * (common[i] + common[j])[:, None]
        apart = sightings.position[i] - sightings.position[j] - offset[i] + offset[j]
        distance2 = mahalanobis2(apart, spread)
        right = responsibilities(sightings, i, j, ratio - 0.5 * distance2)
        kept = distance2 < gate
        if not kept.any():
            return np.zeros_like(offset), pairs[kept]
        weight = right[kept] / np.square(1 + distance2[kept] / gate)
        offset = _adjust(sightings, pairs[kept], spread[kept], weight, processes)
    kept &= right > 0.5
    return offset, pairs[kept]


def relative_variance(sightings: Sightings, known: Ints, pairs: Ints) -> Floats:
    """Variance (m, 2), level and up, of the difference of two drives' common errors after their adjustment.

    Of the other pairs of the same two drives, only the nearest before and after count, with the change of both errors
    over this distance. A pair is thus not judged by its own error, and more pairs would only lower it.
    `known` (k, 2): pairs that determined the adjustment. `pairs` (m, 2): rows of different drives, the lower first.
    """
    drives = int(sightings.drive.max(initial=0)) + 1
    of, asked = (sightings.drive[rows] @ [drives, 1] for rows in (known, pairs))
    order = np.lexsort((known[:, 1], known[:, 0], of))
    known, of = known[order], of[order]
    result = np.zeros((len(pairs), 2))
    # rows are in order of station: a pair has the place of its first row
    rank = len(sightings) + 1
    at = np.searchsorted(of * rank + known[:, 0], asked * rank + pairs[:, 0])
    same = np.zeros(len(pairs), bool)
    inside = at < len(known)
    same[inside] = (known[at[inside]] == pairs[inside]).all(axis=1)
    for column, axes in _AXES:
        variance = np.square(sightings.common_sigma_m[:, column])
        own = sightings.covariance[:, axes, axes].mean(axis=1)
        information = 1 / variance[pairs].sum(axis=1)
        for neighbour in (at - 1, at + same):
            valid = (neighbour >= 0) & (neighbour < len(known))
            valid[valid] = of[neighbour[valid]] == asked[valid]
            rows, other = pairs[valid], known[neighbour[valid]]
            away_s = np.abs(sightings.time_ns[rows] - sightings.time_ns[other]) * 1e-9
            keep = np.exp(-2 * away_s / CORRELATION_S)
            change = (variance[rows] * (1 - keep)).sum(axis=1)
            information[valid] += 1 / (own[other].sum(axis=1) + change)
        result[:, column] = 1 / information
    return result


def _adjust(
    sightings: Sightings,
    pairs: Ints,
    spread: Floats,
    weight: Floats,
    processes: Sequence[csc_array],
) -> Floats:
    """Offsets (n, 3) of one least squares; processes: precisions (n, n) of the prior, for each of `_AXES`."""
    i, j = pairs.T
    count = len(sightings)
    partners = 1.0 + np.bincount(pairs.ravel(), np.repeat(weight, 2), minlength=count)
    # k rows of one panel are k - 1 measurements, not k (k - 1) / 2
    shared = 4 / (partners[i] + partners[j])
    apart = sightings.position[i] - sightings.position[j]
    offset = np.zeros((count, 3))
    for process, (_, axes) in zip(processes, _AXES, strict=True):
        precision = weight * shared / spread[:, axes, axes].mean(axis=1)
        matrix = process + _laplacian(pairs, precision, count)
        right = np.zeros((count, len(axes)))
        np.add.at(right, i, precision[:, None] * apart[:, axes])
        np.subtract.at(right, j, precision[:, None] * apart[:, axes])
        offset[:, axes] = splu(csc_array(matrix), permc_spec="MMD_AT_PLUS_A").solve(right)
    return offset


def _process(sightings: Sightings, sigma: Floats) -> csc_array:
    """Precision (n, n) of the Gauss-Markov processes of all drives, sampled at their sightings."""
    diagonal, variance = 1 / np.square(sigma), sigma[:-1] * sigma[1:]
    step_s = np.maximum(np.diff(sightings.time_ns) * 1e-9, _SHORTEST_S)
    keep = np.where(np.diff(sightings.drive) == 0, np.exp(-step_s / CORRELATION_S), 0.0)
    lost = 1 - keep**2
    # precision of the bridge between neighbours; the ends keep the stationary precision
    bridge = keep**2 / lost / variance
    diagonal[:-1] += bridge
    diagonal[1:] += bridge
    beside = -keep / lost / variance
    matrix = csc_array(diags_array([beside, diagonal, beside], offsets=[-1, 0, 1]))
    matrix.eliminate_zeros()
    return matrix


def _laplacian(pairs: Ints, precision: Floats, count: int) -> csc_array:
    """Normal matrix (n, n) of differences between rows."""
    i, j = pairs.T
    rows, columns = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
    values = np.concatenate([precision, precision, -precision, -precision])
    return csc_array(coo_array((values, (rows, columns)), shape=(count, count)))
