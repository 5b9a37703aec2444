"""Bundle adjustment of a segment with the lens among its unknowns.

Poses and points are eliminated (Schur complement), which leaves normal equations of the lens; those of all segments are
added. The residual of a tie is the projection of its point into the later image minus the mapped projection into the
earlier one. As in the adjustment of landmarks, errors along a track stay independent. The pose of the first image is
held: it is the gauge.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera
from wayside.stages.calibration.lens import LENS, Projection, project
from wayside.stages.calibration.segment import Segment
from wayside.stages.kernels import Array

_FLOOR = 1e-9


class Weights(NamedTuple):
    """Weights of residuals.

    `factor`: on the sigmas of ties. `scale`: where their robust cost (Cauchy) flattens, in sigmas. `anchor_px`: sigma
    of the pixel that defines a point in its first image. `length`: relative sigma of the lengths of the steps.
    """

    factor: float
    scale: float
    anchor_px: float
    length: float


class Equations(NamedTuple):
    """Normal equations of a segment of m images, of which the last 5 of s = 6 m + 5 unknowns are the lens.

    `matrix` (s, s), `right` (s,): of poses and lens. `block` (p, 3, 3), `cross` (p, s, 3), `point_right` (p, 3): of the
    points. `by_all` (n, 2, s), `by_point` (n, 2, 3), `weight` (n,): Jacobians of the ties, px, and one over their
    squared sigmas.
    """

    matrix: Array
    right: Array
    block: Array
    cross: Array
    point_right: Array
    by_all: Array
    by_point: Array
    weight: Array


class Reduced(NamedTuple):
    """Equations of the lens alone, matrix (5, 5) and right (5,), and how the other unknowns follow from it.

    `by_lens` (6 m - 6, 5), `alone` (6 m - 6,): change of the poses by the lens and without it. `inverse` (p, 3, 3): of
    the blocks of the points.
    """

    matrix: Array
    right: Array
    by_lens: Array
    alone: Array
    inverse: Array


class _View(NamedTuple):
    """Points in an image each: pixels and Jacobians.

    rotation (n, 3, 3) and basis (n, 2, 3) of each, inverse (n,) distance, arm (n, 3) from its image to its origin.
    """

    projection: Projection
    rotation: Array
    basis: Array
    inverse: Array
    arm: Array

    def derivatives(self) -> tuple[Array, Array]:
        """Of the pixels by the pose (n, 2, 6) and by the point (n, 2, 3)."""
        in_world = self.projection.by_ray @ self.rotation.transpose(0, 2, 1)
        by_centre = -self.inverse[:, None, None] * in_world
        by_offset = in_world @ self.basis.transpose(0, 2, 1)
        return (
            np.concatenate([self.projection.by_turn, by_centre], axis=2),
            np.concatenate([by_offset, in_world @ self.arm[:, :, None]], axis=2),
        )


def evaluate(segment: Segment, camera: Camera, weights: Weights) -> tuple[float, Array]:
    """Cost, and lengths (n,) of the residuals of the ties in their sigmas."""
    residual, _, _ = _tie_residuals(segment, camera)
    lengths = np.linalg.norm(residual, axis=1) / (weights.factor * segment.sigma_px)
    anchors = _anchor_residuals(segment, camera)[0] / weights.anchor_px
    turns, steps = _prior_residuals(segment, weights)
    cost = weights.scale**2 * np.log1p((lengths / weights.scale) ** 2).sum()
    return float(cost + (anchors**2).sum() + (turns**2).sum() + (steps**2).sum()), lengths


def linearise(segment: Segment, camera: Camera, weights: Weights) -> Equations:
    """Normal equations of a segment, about its poses and points and the lens of the camera."""
    s, count, tracks = segment, len(segment.rotations), len(segment.head)
    size = 6 * count + len(LENS)
    residual, early, late = _tie_residuals(s, camera)
    sigma = weights.factor * s.sigma_px
    lengths = np.linalg.norm(residual, axis=1) / sigma
    weight = 1 / (sigma * np.sqrt(1 + (lengths / weights.scale) ** 2))
    warp = _warps(s.warp)
    early_pose, early_point = early.derivatives()
    late_pose, late_point = late.derivatives()
    by_all = np.zeros((len(residual), 2, size))
    _put(by_all, s.frames[:, 1], late_pose)
    _put(by_all, s.frames[:, 0], -warp @ early_pose)
    by_all[:, :, 6 * count :] = late.projection.by_lens - warp @ early.projection.by_lens
    by_point = late_point - warp @ early_point
    anchor, first = _anchor_residuals(s, camera)
    first_pose, first_point = first.derivatives()
    anchor_all = np.zeros((tracks, 2, size))
    _put(anchor_all, s.frames[s.head, 0], first_pose)
    anchor_all[:, :, 6 * count :] = first.projection.by_lens
    jacobian = np.concatenate([anchor_all / weights.anchor_px, by_all * weight[:, None, None]])
    points = np.concatenate([first_point / weights.anchor_px, by_point * weight[:, None, None]])
    errors = np.concatenate([anchor / weights.anchor_px, residual * weight[:, None]])
    track = np.concatenate([np.arange(tracks), s.track])
    order = np.argsort(track, kind="stable")  # sums over the rows of each track
    jacobian, points, errors = jacobian[order], points[order], errors[order]
    heads = np.searchsorted(track[order], np.arange(tracks))
    flat, turned = jacobian.reshape(-1, size), points.transpose(0, 2, 1)
    matrix, right = flat.T @ flat, -flat.T @ errors.ravel()
    _add_priors(s, weights, matrix, right)
    return Equations(
        matrix,
        right,
        np.add.reduceat(turned @ points, heads),
        np.add.reduceat(jacobian.transpose(0, 2, 1) @ points, heads),
        -np.add.reduceat((turned @ errors[:, :, None])[:, :, 0], heads),
        by_all,
        by_point,
        weight**2,
    )


def reduced(equations: Equations, damping: float) -> Reduced:
    """Eliminate points and poses, with `damping` added, relative, to the diagonals of their equations."""
    e, size = equations, len(equations.right)
    block = e.block.copy()
    block[:, range(3), range(3)] *= 1 + damping
    block[:, range(3), range(3)] += _FLOOR
    inverse: Array = np.asarray(np.linalg.inv(block), np.float64)
    wide = e.cross @ inverse
    matrix = e.matrix - np.tensordot(wide, e.cross, axes=((0, 2), (0, 2)))
    right = e.right - np.tensordot(wide, e.point_right, axes=((0, 2), (0, 1)))
    free, lens = slice(6, size - len(LENS)), slice(size - len(LENS), size)
    poses = matrix[free, free] + np.diag(damping * np.diag(matrix[free, free]) + _FLOOR)
    solved = np.linalg.solve(poses, np.column_stack([matrix[free, lens], right[free]]))
    by_lens, alone = -solved[:, :-1], solved[:, -1]
    return Reduced(
        matrix[lens, lens] + matrix[lens, free] @ by_lens,
        right[lens] - matrix[lens, free] @ alone,
        by_lens,
        alone,
        inverse,
    )


def lens_gain(segment: Segment, equations: Equations, solved: Reduced) -> Array:
    """Part (n, 2, 5) of the right side of the lens by each pixel of the residual of each tie."""
    e = equations
    response = np.concatenate([np.zeros((6, len(LENS))), solved.by_lens, np.eye(len(LENS))])
    moved = -solved.inverse @ (e.cross.transpose(0, 2, 1) @ response)
    by_lens = e.by_all @ response + e.by_point @ moved[segment.track]
    return np.asarray(by_lens * e.weight[:, None, None])


def updated(segment: Segment, equations: Equations, solved: Reduced, lens: Array) -> Segment:
    """The segment after a step of the lens by `lens` (5,)."""
    poses = np.concatenate([np.zeros(6), solved.alone + solved.by_lens @ lens])
    everything = np.concatenate([poses, lens])
    rest = equations.point_right - equations.cross.transpose(0, 2, 1) @ everything
    moves = poses.reshape(-1, 6)
    turned = [
        rotation @ cv2.Rodrigues(move[:3])[0]
        for rotation, move in zip(segment.rotations, moves, strict=True)
    ]
    return segment._replace(
        rotations=np.array(turned),
        centres=segment.centres + moves[:, 3:],
        points=segment.points + (solved.inverse @ rest[:, :, None])[:, :, 0],
    )


def _put(jacobian: Array, frame: NDArray[np.int64], by_pose: Array) -> None:
    """Fill the columns of each row's image."""
    rows = np.arange(len(frame))[:, None, None]
    columns = 6 * frame[:, None] + np.arange(6)
    jacobian[rows, np.arange(2)[None, :, None], columns[:, None, :]] = by_pose


def _view(
    segment: Segment, camera: Camera, frame: NDArray[np.int64], track: NDArray[np.int64]
) -> _View:
    s = segment
    rotation, basis, inverse = s.rotations[frame], s.basis[track], s.points[track, 2]
    arm = s.origin[track] - s.centres[frame]
    offset = (s.points[track, None, :2] @ basis)[:, 0]
    world = s.ray[track] + offset + inverse[:, None] * arm
    projection = project(camera, (world[:, None] @ rotation)[:, 0])
    return _View(projection, rotation, basis, inverse, arm)


def _warps(warp: Array) -> Array:
    """Matrices (n, 2, 2) of warps (n, 3)."""
    matrices = np.zeros((len(warp), 2, 2))
    matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1] = warp.T
    return matrices


def _tie_residuals(segment: Segment, camera: Camera) -> tuple[Array, _View, _View]:
    """Residuals (n, 2) of ties, px, and their points in the earlier and in the later image."""
    s = segment
    early = _view(s, camera, s.frames[:, 0], s.track)
    late = _view(s, camera, s.frames[:, 1], s.track)
    offset = early.projection.pixels - s.start
    mapped = s.end + (_warps(s.warp) @ offset[:, :, None])[:, :, 0]
    return late.projection.pixels - mapped, early, late


def _anchor_residuals(segment: Segment, camera: Camera) -> tuple[Array, _View]:
    """Residuals (p, 2) of points in the first image of their track, px."""
    s = segment
    view = _view(s, camera, s.frames[s.head, 0], np.arange(len(s.head)))
    return view.projection.pixels - s.start[s.head], view


def _prior_residuals(segment: Segment, weights: Weights) -> tuple[Array, Array]:
    """Of the turns (m - 1, 3) and of the lengths (m - 1,) of the steps, in their sigmas."""
    s = segment
    turns = np.zeros((len(s.lengths), 3))
    for k in np.flatnonzero(np.isfinite(s.turn_sigma)):
        gap = s.turns[k].T @ s.rotations[k].T @ s.rotations[k + 1]
        turns[k] = cv2.Rodrigues(gap)[0].ravel() / s.turn_sigma[k]
    found = np.linalg.norm(np.diff(s.centres, axis=0), axis=1)
    return turns, (found / s.lengths - 1) / weights.length


def _add_priors(segment: Segment, weights: Weights, matrix: Array, right: Array) -> None:
    s = segment
    turns, steps = _prior_residuals(s, weights)
    gaps = np.diff(s.centres, axis=0)
    for k in range(len(s.lengths)):
        rows = np.zeros((4, len(right)))
        if np.isfinite(s.turn_sigma[k]):
            rows[:3, 6 * k : 6 * k + 3] = -(s.rotations[k + 1].T @ s.rotations[k])
            rows[:3, 6 * k + 6 : 6 * k + 9] = np.eye(3)
            rows[:3] /= s.turn_sigma[k]
        length = max(float(np.linalg.norm(gaps[k])), _FLOOR)
        rows[3, 6 * k + 9 : 6 * k + 12] = gaps[k] / (length * s.lengths[k] * weights.length)
        rows[3, 6 * k + 3 : 6 * k + 6] = -rows[3, 6 * k + 9 : 6 * k + 12]
        matrix += rows.T @ rows
        right -= rows.T @ np.append(turns[k], steps[k])
