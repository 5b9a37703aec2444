"""Ties of consecutive steps: their displacement, tracks of them, and a selection spread evenly over the image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Rows
from wayside.schemas.frame import Camera
from wayside.schemas.motion import Motion
from wayside.stages.geometry import rays_of_ideal
from wayside.stages.kernels import Array, compiled

SLIDING_PX = 0.12
"""Ties that may slide further along the edges of their patches are left out."""
DISPLACEMENT_SIGMA = 0.002
"""Scatter of a tie as a fraction of its displacement in the image (measured; the drives are not on record)."""
TIE_SCALE = 1.0
"""Scale of the robust cost of a tie, standard deviations."""
ANCHOR_SIGMA_PX = 0.01
"""Scatter of the first corner of a track: it defines the point."""
NEAREST_TIE_M, FARTHEST_TIE_M = 1.0, 2000.0
"""Least and largest depth of a tie at the start."""

Numbers = NDArray[np.int64]
Flags = NDArray[np.bool_]

NEAREST_DEPTH = 1e-6
"""Smallest third coordinate of a turned ray: points next to or behind the camera have no place in its image."""


@dataclass(frozen=True, slots=True)
class StepTies(Rows):
    """Ties of the steps of a window, in n rows. Corners and rays (n, 2) are in both frames; the warp is (n, 3).

    `place` (n, 3): in the earlier camera, m, nan where unknown. `pixel` (n, 2): ideal, in the later image.
    `displacement_px` (n,): in it, by translation. `scatter` (n,): errors over those stated, by step.
    """

    step: Numbers
    corners: Numbers
    source: Array
    target: Array
    warp: Array
    place: Array
    pixel: Array
    displacement_px: Array
    scatter: Array


NO_TIES = StepTies(
    np.zeros(0, np.int64), np.zeros((0, 2), np.int64), np.zeros((0, 2)), np.zeros((0, 2)),
    np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0), np.zeros(0),
)  # fmt: skip


def ties_of_step(
    number: int, motion: Motion, before: Camera, now: Camera, *, inliers: bool
) -> StepTies:
    """Ties of a step that slide less than `SLIDING_PX`, of the inliers or of all; none without a step."""
    ties, pose = motion.ties, motion.step
    if ties is None or pose is None:
        return NO_TIES
    kept = np.flatnonzero((ties.sigma_px < SLIDING_PX) & (ties.inlier | (not inliers)))
    source = rays_of_ideal(before, ties.previous[kept])
    target = rays_of_ideal(now, ties.current[kept])
    return StepTies(
        np.full(len(source), number),
        ties.rows[kept],
        source,
        target,
        ties.warp[kept],
        pose.to_world(ties.point[kept]),
        ties.current[kept],
        translation_px(pose.rotation, source, target, (now.fx + now.fy) / 2),
        np.full(len(source), ties.scatter),
    )


def translation_px(rotation: Array, before: Array, after: Array, focal_px: float) -> Array:
    """How far ties move in the image by the translation of the camera alone, (n,) px.

    `rotation` (3, 3): of the later camera in the earlier one. `before`, `after`: rays (n, 2) in both.
    """
    far = before @ rotation[:2] + rotation[2]
    moved = after - far[:, :2] / np.maximum(far[:, 2:], NEAREST_DEPTH)
    return np.asarray(np.linalg.norm(moved, axis=1) * focal_px)


def link_tracks(step: Numbers, corners: Numbers) -> Numbers:
    """Number of the track of each tie, (n,), in the order of first appearance.

    `step` (n,): ascending. `corners` (n, 2): of the earlier and the later image that a tie joins; -1: no corner, the
    tie is a track of its own. A tie that ends at a corner is followed by the tie of the next step that starts there. Of
    two that end at the same corner the last is followed.
    """
    track = np.empty(len(step), np.int64)
    _link(step, corners, np.full((2, int(corners.max(initial=-1)) + 1), -1, np.int64), track)
    return track


@compiled
def _link(step: Numbers, corners: Numbers, ends: Numbers, track: Numbers) -> None:
    count = 0
    for i in range(len(step)):
        # rows of ties by the corner at which they end, of even and of odd steps
        before, first, last = ends[(step[i] - 1) % 2], corners[i, 0], corners[i, 1]
        row = before[first] if first >= 0 else -1
        if row >= 0 and step[row] == step[i] - 1:
            track[i], before[first] = track[row], -1
        else:
            track[i] = count
            count += 1
        if last >= 0:
            ends[step[i] % 2, last] = i


def select_tracks(track: Numbers, step: Numbers, cell: Numbers) -> NDArray[np.bool_]:
    """Which ties (n,) to keep: whole tracks, longest first, each that reaches a cell (n, 2) of a step without a tie."""
    wide, tall = cell.max(axis=0, initial=0) + 1
    key = np.ascontiguousarray((step * tall + cell[:, 1]) * wide + cell[:, 0], np.int64)
    order = np.argsort(track, kind="stable").astype(np.int64)
    length = np.bincount(track)
    first = np.concatenate([[0], np.cumsum(length)]).astype(np.int64)
    longest = np.argsort(-length, kind="stable").astype(np.int64)
    kept = np.zeros(len(track), np.bool_)
    _select(first, order, longest, key, np.zeros(int(key.max(initial=-1)) + 1, np.bool_), kept)
    return kept


@compiled
def _select(
    first: Numbers, order: Numbers, longest: Numbers, key: Numbers, full: Flags, kept: Flags
) -> None:
    for n in longest:
        free = False
        for i in range(first[n], first[n + 1]):
            free |= not full[key[order[i]]]
        if free:
            for i in range(first[n], first[n + 1]):
                full[key[order[i]]] = True
                kept[order[i]] = True
