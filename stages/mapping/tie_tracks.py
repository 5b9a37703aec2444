"""Ties of consecutive steps joined to tracks, and a well spread few of these."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled

Numbers = NDArray[np.int64]


def link_tracks(step: Numbers, corners: Numbers) -> Numbers:
    """Number of the track of each tie, (n,), in the order of first appearance.

    Parameters
    ----------
    step
        Step of each tie, ascending, (n,).
    corners
        Corners of the earlier and the later picture that a tie stems from, (n, 2); -1: of none, a track of its own.
        A tie of one step that ends at a corner goes on in that of the next which starts there; of two that end at the
        same corner the last goes on.
    """
    n = len(step)
    track = np.full(n, -1, np.int64)
    table = np.full(int(corners.max(initial=-1)) + 1, -1, np.int64)
    count, last = 0, -2
    for k in np.unique(step):
        mine = np.flatnonzero(step == k)
        start = corners[mine, 0]
        if k == last + 1:
            known = np.where(start >= 0, table[start], -1)
            # of several ties from one corner one goes on
            _, once = np.unique(np.where(known >= 0, known, -1 - mine), return_index=True)
            single = np.zeros(len(mine), np.bool_)
            single[once] = True
            track[mine] = np.where(single, known, -1)
        fresh = mine[track[mine] < 0]
        track[fresh] = count + np.arange(len(fresh))
        count += len(fresh)
        table[:] = -1
        ends = corners[mine, 1]
        table[ends[ends >= 0]] = track[mine[ends >= 0]]
        last = int(k)
    return track


def spread_tracks(track: Numbers, step: Numbers, cell: Numbers) -> NDArray[np.bool_]:
    """Which ties (n,) to keep: whole tracks, the longest first, until each cell (n, 2) of each step has one."""
    wide, tall = cell.max(axis=0, initial=0) + 1
    key = np.ascontiguousarray((step * tall + cell[:, 1]) * wide + cell[:, 0], np.int64)
    order = np.argsort(track, kind="stable").astype(np.int64)
    length = np.bincount(track)
    first = np.concatenate([[0], np.cumsum(length)]).astype(np.int64)
    turn = np.argsort(-length, kind="stable").astype(np.int64)
    kept = np.zeros(len(track), np.bool_)
    _spread(first, order, turn, key, np.zeros(int(key.max(initial=-1)) + 1, np.bool_), kept)
    return kept


@compiled
def _spread(
    first: Numbers,
    order: Numbers,
    turn: Numbers,
    key: Numbers,
    full: NDArray[np.bool_],
    kept: NDArray[np.bool_],
) -> None:
    for n in turn:
        free = False
        for i in range(first[n], first[n + 1]):
            free |= not full[key[order[i]]]
        if free:
            for i in range(first[n], first[n + 1]):
                full[key[order[i]]] = True
                kept[order[i]] = True
