"""Bundle adjustment of a segment with the lens among its unknowns.

Poses and points are eliminated (Schur complement), which leaves normal equations of the lens; those of all segments are
added. The residual of a tie is the projection of its point into the later image minus the mapped projection into the
earlier one. As in the adjustment of landmarks, errors along a track stay independent. The pose of the first image is
held: it is the gauge.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera
from wayside.stages.calibration.segment import Segment
from wayside.stages.geometry import to_rays
from wayside.stages.kernels import Array

_FLOOR = 1e-9

LENS = ("focal", "cx", "cy", "k1", "k2")
"""Changes of a lens: logarithm of the factor of both focal lengths; principal point, px; radial distortion."""

RADIAL = [0, 3, 4]
"""Of `LENS`, what moves points along their radius. Motion in the images says little of the principal point."""

_NEAREST = 1e-3

_RAYS = 20
"""From the axis to a corner."""


def changed_camera(camera: Camera, lens: Array) -> Camera:
    """The camera after a change of its lens by `lens` (5,), in the order of `LENS`."""
    focal, cx, cy, k1, k2 = lens.tolist()
    d = [*camera.distortion, *[0.0] * (5 - len(camera.distortion))]
    return replace(
        camera,
        fx=camera.fx * exp(focal),
        fy=camera.fy * exp(focal),
        cx=camera.cx + cx,
        cy=camera.cy + cy,
        distortion=(d[0] + k1, d[1] + k2, *d[2:]),
    )


def displacement(camera: Camera, lens: Array) -> float:
    """Largest displacement of a point of the image by the radial part of a change of its lens (5,), to first order.

    Relative to its distance from the principal point; of rays from the axis to the farthest corner.
    """
    centre = np.array([camera.cx, camera.cy])
    corners = np.array([[x, y] for x in (0, camera.width - 1) for y in (0, camera.height - 1)])
    farthest = max(corners - centre, key=np.linalg.norm)
    arms = np.linspace(0.05, 1, _RAYS)[:, None] * farthest
    rays = np.column_stack([to_rays(camera, centre + arms), np.ones(_RAYS)])
    by_lens = project(changed_camera(camera, np.zeros(len(LENS))), rays).by_lens
    moved = by_lens[:, :, RADIAL] @ lens[RADIAL]
    return float((np.linalg.norm(moved, axis=1) / np.linalg.norm(arms, axis=1)).max())


class Projection(NamedTuple):
    """Recorded pixels (n, 2), and their Jacobians.

    `by_turn` (n, 2, 3): by a rotation of the camera (rad, its axes). `by_ray` (n, 2, 3). `by_lens` (n, 2, 5).
    """

    pixels: Array
    by_turn: Array
    by_ray: Array
    by_lens: Array


def project(camera: Camera, rays: Array) -> Projection:
    """Project rays (n, 3) of the camera frame; those beside or behind the camera as if just ahead of it.

    The distortion has at least the two coefficients k1 and k2.
    """
    solid = np.column_stack([rays[:, :2], np.maximum(rays[:, 2], _NEAREST)])
    still, coefficients = np.zeros(3), np.array(camera.distortion)
    found, slopes = cv2.projectPoints(solid, still, still, camera.matrix, coefficients)
    # Columns of OpenCV: rotation and position of the points, focal lengths, principal point, distortion.
    by: Array = np.asarray(slopes, np.float64).reshape(len(rays), 2, -1)
    scale = by[:, :, 6:8] @ np.array([[camera.fx], [camera.fy]])
    by_lens = np.concatenate([scale, by[:, :, 8 : 7 + len(LENS)]], axis=2)
    pixels = np.asarray(found, np.float64).reshape(-1, 2)
    return Projection(pixels, -by[:, :, :3], by[:, :, 3:6], by_lens)


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
    both = np.column_stack([matrix[free, lens], right[free]])
    solved: Array = np.asarray(np.linalg.solve(poses, both), np.float64)
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
