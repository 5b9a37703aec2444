"""Faults of the poses and fixes of a log, in words: a time offset, outliers, jumps, gaps."""

from collections.abc import Sequence

import numpy as np

from wayside.stages.georeference.measurements import AbsoluteMeasurements, RelativeMotionChain
from wayside.stages.georeference.path import PathPoint
from wayside.stages.georeference.trajectory import Trajectory
from wayside.stages.kernels import Array, Numbers

GAP_S = 10.0
"""Longer gaps between poses or fixes are reported."""
JUMP_M = 0.5
"""Shorter jumps are not reported."""
JUMP_FACTOR = 8.0
"""A reported jump exceeds the median disagreement of neighbouring frames by this factor."""
LONGEST_LEVER_M = 15.0
"""No vehicle on a road carries its antenna further from its camera."""


def notes_on(
    frames: Sequence[int],
    chain: RelativeMotionChain,
    measured: AbsoluteMeasurements,
    found: Trajectory,
    what: str,
) -> tuple[str, ...]:
    """Notes on `what` was measured ("poses" or "fixes"); frames: the index of each row."""
    notes = [_time_offset(chain, found, what)]
    if found.outliers:
        notes.append(
            f"{found.outliers} of {len(found.weight)} {what} do not fit the motion between the frames: excluded"
        )
    # Positions leave the relative motion and stay off; an outlier, which comes back at once, is no jump.
    off, later = _disagreement(chain, measured, found)
    usual = float(np.median(off)) if len(off) > 2 else np.inf
    far = np.pad(off > max(JUMP_M, JUMP_FACTOR * usual), 1)
    alone = np.flatnonzero(far[1:-1] & ~far[:-2] & ~far[2:])
    if len(alone):
        largest = alone[off[alone].argmax()]
        times = "once" if len(alone) == 1 else f"{len(alone)} times"
        where = frames[later[largest]]
        notes.append(f"the {what} jump {times}, furthest by {off[largest]:.1f} m at frame {where}")
    notes.append(_gap(frames, chain.time_s, measured.row, found, what))
    return tuple(note for note in notes if note)


def notes_on_spacing(points: Sequence[PathPoint]) -> tuple[str, ...]:
    """Where images are not the stated spacing apart, and what their distances are by points instead."""
    followed = [p for p in points if p.source == "points" and p.baseline_m]
    if not followed:
        return ()
    lengths = [p.baseline_m or 0.0 for p in followed]
    return (
        f"the distance between images is not constant. In {len(followed)} of {len(points) - 1} steps, the first to "
        f"frame {followed[0].frame}, points in the images give it: {min(lengths):.2f} m to {max(lengths):.2f} m. The "
        "spacing only gives their mean, so positions and sizes share a scale error",
    )


def _time_offset(chain: RelativeMotionChain, found: Trajectory, what: str) -> str:
    offset = found.time_offset_s
    if found.impossible_offset_s:
        return (
            f"the {what} seem to be {abs(found.impossible_offset_s):.1f} s off from the images, more than any "
            "recorder delays: not corrected"
        )
    if not offset:
        return ""
    late = "behind" if offset > 0 else "ahead of"
    note = f"the {what} are {abs(offset):.3f} s {late} the images (± {found.time_offset_sigma_s:.3f} s)"
    if what == "fixes":
        note += f", or their antenna {abs(offset) * speed_mps(chain):.1f} m {late} the camera"
    return f"{note}: corrected"


def speed_mps(chain: RelativeMotionChain) -> float:
    """Mean speed of a drive."""
    return float(chain.length[1:].sum() / max(float(chain.time_s[-1]), 1e-9))


def contradiction(chain: RelativeMotionChain, found: Trajectory) -> str:
    """Why fixes cannot be those of this drive, in words; empty where they can."""
    offset = found.impossible_offset_s or found.time_offset_s
    lever_m = abs(offset) * speed_mps(chain)
    if found.impossible_offset_s or lever_m > LONGEST_LEVER_M:
        return (
            f"they would be {abs(offset):.1f} s {'behind' if offset > 0 else 'ahead of'} the images, or their antenna "
            f"{lever_m:.0f} m from the camera"
        )
    count = len(found.weight)
    if 2 * found.outliers > count:
        return f"{found.outliers} of {count} do not fit the motion between the frames"
    return ""


def _disagreement(
    chain: RelativeMotionChain, measured: AbsoluteMeasurements, found: Trajectory
) -> tuple[Array, Numbers]:
    """Distance (k,) between measured and relative displacement of neighbouring frames; rows (k,) of the later."""
    pair = np.flatnonzero(np.diff(measured.row) == 1)
    before, later = measured.row[pair], measured.row[pair + 1]
    lever = found.rotation @ measured.lever_arm_m
    step = found.scale[later, None] * chain.translation[later]
    moved = (found.rotation[before] @ step[:, :, None])[:, :, 0] + lever[later] - lever[before]
    off = np.linalg.norm(measured.position[pair + 1] - measured.position[pair] - moved, axis=1)
    return np.asarray(off), np.asarray(later)


def _gap(frames: Sequence[int], time_s: Array, rows: Numbers, found: Trajectory, what: str) -> str:
    held = np.unique(np.concatenate([[0], rows, [len(frames) - 1]]))
    gaps = np.diff(time_s[held])
    if not gaps.max(initial=0.0) > GAP_S:
        return ""
    longest = int(np.argmax(gaps))
    first, last = int(held[longest]), int(held[longest + 1])
    variance = found.covariance[first : last + 1, :2, :2].trace(axis1=1, axis2=2)
    return (
        f"no {what} for {gaps[longest]:.0f} s (frames {frames[first]} to {frames[last]}): positions there are "
        f"known to {np.sqrt(variance.max()):.1f} m"
    )
