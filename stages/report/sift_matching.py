"""Matching regions by the SIFT key points on them (report chapter 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def match_points(
    first: NDArray[np.float32], second: NDArray[np.float32], ratio: float
) -> NDArray[np.int64]:
    """Pairs (k, 2) of descriptors that are each other's nearest and clearly nearer than the second (Lowe's ratio test).

    Parameters
    ----------
    first, second
        Descriptors (n, d) and (m, d).
    ratio
        Largest distance to the nearest over that to the second nearest.
    """
    if len(first) < 1 or len(second) < 2:
        return np.zeros((0, 2), np.int64)
    squares = (first**2).sum(axis=1)[:, None] + (second**2).sum(axis=1)[None]
    distance = np.maximum(squares - 2 * first @ second.T, 0)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(first))
    least = distance[rows, nearest]
    back = distance.argmin(axis=0)
    distance[rows, nearest] = np.inf
    clear = least < ratio**2 * distance.min(axis=1)
    good = clear & (back[nearest] == rows)
    return np.stack([rows[good], nearest[good]], axis=1)


def vote_regions(
    pairs: NDArray[np.int64], first_region: NDArray[np.int32], second_region: NDArray[np.int32]
) -> NDArray[np.int64]:
    """Pairs of regions (k, 2) for which most of both regions' matched points vote, by second region ascending.

    Parameters
    ----------
    pairs
        Matched points (n, 2).
    first_region, second_region
        Region of each point of either image.
    """
    if len(pairs) == 0:
        return np.zeros((0, 2), np.int64)
    a, b = first_region[pairs[:, 0]], second_region[pairs[:, 1]]
    voted, votes = np.unique(np.stack([a, b], axis=1), axis=0, return_counts=True)
    chosen = []
    for region in np.unique(voted[:, 1]):
        mine = np.flatnonzero(voted[:, 1] == region)
        best = mine[np.argmax(votes[mine])]
        rival = np.flatnonzero(voted[:, 0] == voted[best, 0])
        if rival[np.argmax(votes[rival])] == best:
            chosen.append(voted[best])
    return np.array(chosen, np.int64).reshape(-1, 2)
