"""What the poses and fixes of a log have wrong, in words: a lag, places that do not fit, jumps, gaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wayside.stages.georeference import Chain, Seen, Trajectory
from wayside.stages.kernels import Array

LONG_GAP_S = 10.0
JUMP_M, JUMP_TIMES = 0.5, 8.0
"""A jump is as long, and so many times as long as half of all ways between neighbours are off."""


def notes_on(
    frames: Sequence[int], chain: Chain, seen: Seen, found: Trajectory, what: str
) -> tuple[str, ...]:
    """Notes on `what` was seen ("poses" or "fixes"), in the frames of these numbers."""
    every = (
        _lag(chain, found, what),
        _outliers(found, what),
        _jumps(frames, chain, seen, found, what),
        _gap(frames, chain, seen, found, what),
    )
    return tuple(note for note in every if note)


def _lag(chain: Chain, found: Trajectory, what: str) -> str:
    if not found.lag_s:
        return ""
    late = "behind" if found.lag_s > 0 else "ahead of"
    note = (
        f"the {what} are {abs(found.lag_s):.3f} s {late} the pictures (± {found.lag_sigma_s:.3f} s)"
    )
    if what == "fixes":
        speed = chain.length[1:].sum() / max(float(chain.time_s[-1]), 1e-9)
        where = "behind" if found.lag_s > 0 else "ahead of"
        note += f", or their antenna {abs(found.lag_s) * speed:.1f} m {where} the camera"
    return f"{note}: corrected"


def _outliers(found: Trajectory, what: str) -> str:
    if not found.outliers:
        return ""
    count = len(found.weight)
    return f"{found.outliers} of {count} {what} do not fit the way between the pictures: left out"


def _jumps(frames: Sequence[int], chain: Chain, seen: Seen, found: Trajectory, what: str) -> str:
    """Where places go another way than the pictures, and do not come back at once as an outlier does."""
    off, later = _ways_off(chain, seen, found)
    if len(off) < 3:
        return ""
    far = off > max(JUMP_M, JUMP_TIMES * float(np.median(off)))
    beside = np.zeros(len(off), bool)
    beside[1:] |= far[:-1]
    beside[:-1] |= far[1:]
    alone = np.flatnonzero(far & ~beside)
    if not len(alone):
        return ""
    largest = alone[np.argmax(off[alone])]
    times = "once" if len(alone) == 1 else f"{len(alone)} times"
    return f"the {what} jump {times}, furthest by {off[largest]:.1f} m at picture {frames[later[largest]]}"


def _ways_off(chain: Chain, seen: Seen, found: Trajectory) -> tuple[Array, NDArray[np.int64]]:
    """Distance (k,) between the ways by places and by pictures, between neighbouring frames; rows (k,) of the later."""
    pair = np.flatnonzero(np.diff(seen.row) == 1)
    before, later = seen.row[pair], seen.row[pair + 1]
    arm = found.rotation @ seen.arm
    step = found.stretch[later, None] * chain.step[later]
    way = (found.rotation[before] @ step[:, :, None])[:, :, 0] + arm[later] - arm[before]
    off = np.linalg.norm(seen.place[pair + 1] - seen.place[pair] - way, axis=1)
    return np.asarray(off), np.asarray(later)


def _gap(frames: Sequence[int], chain: Chain, seen: Seen, found: Trajectory, what: str) -> str:
    held = np.unique(np.concatenate([[0], seen.row, [len(frames) - 1]]))
    if len(held) < 2:
        return ""
    gaps = np.diff(chain.time_s[held])
    longest = int(np.argmax(gaps))
    if gaps[longest] <= LONG_GAP_S:
        return ""
    first, last = int(held[longest]), int(held[longest + 1])
    spread = found.covariance[first : last + 1, :2, :2].trace(axis1=1, axis2=2)
    return (
        f"no {what} for {gaps[longest]:.0f} s (pictures {frames[first]} to {frames[last]}): places there are "
        f"known to {np.sqrt(spread.max()):.1f} m"
    )
