"""Bundle adjustment of a segment with the lens among its unknowns.

Poses and points are eliminated (Schur complement), which leaves normal equations of the lens; those of all segments are
added. The residual of a tie is the projection of its point into the later image minus the mapped projection into the
earlier one. As in the adjustment of landmarks, errors along a track stay independent. The pose of the first image is
held: it is the gauge.
"""

from dataclasses import replace
from math import exp
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Camera
from wayside.stages.adjustment import ANCHOR_SIGMA_PX, TIE_SCALE
from wayside.stages.calibration.segment import Segment
from wayside.stages.geometry import to_rays
from wayside.stages.kernels import Array, Numbers, compiled, compiled_within

_FLOOR = 1e-9

LENS = ("focal", "cx", "cy", "k1", "k2")
"""Changes of a lens: logarithm of the factor of both focal lengths; principal point, px; radial distortion."""

RADIAL = [0, 3, 4]
"""Of `LENS`, what moves points along their radius. Motion in the images says little of the principal point."""

LENGTH_SIGMA = 0.2
"""Relative scatter of the lengths of steps: they do not depend on the lens and only fix the scale."""

_WIDEST = 3.0
"""Tangent of the angle from the axis beyond which no lens here sees."""

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
    """Project rays (n, 3) of the camera frame. Those beside or behind the camera stay where the widest angle is.

    Their Jacobians are 0: fifth powers of their tangents would outweigh all other points. The distortion has at least
    the two coefficients k1 and k2.
    """
    ahead = np.maximum(rays[:, 2], np.linalg.norm(rays[:, :2], axis=1) / _WIDEST)
    solid = np.column_stack([rays[:, :2], ahead])
    still, coefficients = np.zeros(3), np.array(camera.distortion)
    found, slopes = cv2.projectPoints(solid, still, still, camera.matrix, coefficients)
    # Columns of OpenCV: rotation and position of the points, focal lengths, principal point, distortion.
    by: Array = np.asarray(slopes, np.float64).reshape(len(rays), 2, -1)
    by[ahead > rays[:, 2]] = 0.0
    scale = by[:, :, 6:8] @ np.array([[camera.fx], [camera.fy]])
    by_lens = np.concatenate([scale, by[:, :, 8 : 7 + len(LENS)]], axis=2)
    pixels = np.asarray(found, np.float64).reshape(-1, 2)
    return Projection(pixels, -by[:, :, :3], by[:, :, 3:6], by_lens)


class Equations(NamedTuple):
    """Normal equations of a segment of m images, of which the last 5 of s = 6 m + 5 unknowns are the lens.

    `matrix` (s, s), `right` (s,): of poses and lens. `block` (p, 3, 3), `cross` (p, 3, s), `point_right` (p, 3): of the
    points. `slopes` (o, 2, 14): of the pixel of each point in each image that shows it, by the pose, the lens and the
    point. `weight` (n,): one over the squared sigmas of the ties, px.
    """

    matrix: Array
    right: Array
    block: Array
    cross: Array
    point_right: Array
    slopes: Array
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


def project_segment(segment: Segment, camera: Camera) -> Projection:
    """Each point of a segment in each image that shows it, through a camera."""
    s, frame, track = segment, segment.frame, segment.track
    offset = (s.points[track, None, :2] @ s.basis[track])[:, 0]
    world = s.ray[track] + offset + s.points[track, 2:] * (s.origin[track] - s.centres[frame])
    return project(camera, (world[:, None] @ s.rotations[frame])[:, 0])


def _slopes(segment: Segment, seen: Projection) -> Array:
    """Of the pixels by the pose, the lens and the point, (o, 2, 14)."""
    s, frame, track = segment, segment.frame, segment.track
    in_world = seen.by_ray @ s.rotations[frame].transpose(0, 2, 1)
    by_centre = -s.points[track, 2, None, None] * in_world
    by_offset = in_world @ s.basis[track].transpose(0, 2, 1)
    by_inverse = in_world @ (s.origin[track] - s.centres[frame])[:, :, None]
    return np.concatenate([seen.by_turn, by_centre, seen.by_lens, by_offset, by_inverse], axis=2)


def evaluate(segment: Segment, seen: Projection, factor: float) -> tuple[float, Array]:
    """Cost, and lengths (n,) of the residuals of the ties in their sigmas times `factor`."""
    anchors, residual = _residuals(segment, seen.pixels)
    lengths = np.linalg.norm(residual, axis=1) / (factor * segment.sigma_px)
    turns, steps = _prior_residuals(segment)
    cost = TIE_SCALE**2 * np.log1p((lengths / TIE_SCALE) ** 2).sum()
    cost += ((anchors / ANCHOR_SIGMA_PX) ** 2).sum() + (turns**2).sum() + (steps**2).sum()
    return float(cost), lengths


def linearise(segment: Segment, seen: Projection, factor: float) -> Equations:
    """Normal equations of a segment, about its poses and points and the lens of the camera."""
    s, (anchors, residual) = segment, _residuals(segment, seen.pixels)
    sigma = factor * s.sigma_px
    lengths = np.linalg.norm(residual, axis=1) / sigma
    weight = 1 / (sigma * np.sqrt(1 + (lengths / TIE_SCALE) ** 2))
    size, points = 6 * len(s.rotations) + len(LENS), len(s.head)
    empty = np.zeros((size, size)), np.zeros(size), np.zeros((points, 3, 3))
    cross, point_right = np.zeros((points, 3, size)), np.zeros((points, 3))
    found = Equations(*empty, cross, point_right, _slopes(s, seen), weight**2)
    late = np.concatenate([s.early[s.head], s.early + 1])
    weights = np.concatenate([np.full(points, 1 / ANCHOR_SIGMA_PX), weight])
    errors = np.concatenate([anchors, residual])
    _accumulate(s.frame, s.track, late, s.warp, errors, weights, found)
    found.matrix[:] += np.tril(found.matrix, -1).T + np.triu(found.matrix, 1).T
    _add_priors(s, found.matrix, found.right)
    return found


def reduced(equations: Equations, damping: float) -> Reduced:
    """Eliminate points and poses, with `damping` added, relative, to the diagonals of their equations."""
    e, size = equations, len(equations.right)
    block = e.block.copy()
    block[:, range(3), range(3)] *= 1 + damping
    block[:, range(3), range(3)] += _FLOOR
    inverse: Array = np.asarray(np.linalg.inv(block), np.float64)
    wide, cross = (inverse @ e.cross).reshape(-1, size), e.cross.reshape(-1, size)
    matrix, right = e.matrix - wide.T @ cross, e.right - wide.T @ e.point_right.ravel()
    free, lens = slice(6, size - len(LENS)), slice(size - len(LENS), size)
    poses = matrix[free, free] + np.diag(damping * np.diag(matrix[free, free]) + _FLOOR)
    both = np.column_stack([matrix[free, lens], right[free]])
    solved: Array = np.asarray(np.linalg.solve(poses, both), np.float64)
    by_lens, alone = -solved[:, :-1], solved[:, -1]
    own, rest = matrix[lens, lens] + matrix[lens, free] @ by_lens, matrix[lens, free] @ alone
    return Reduced(own, right[lens] - rest, by_lens, alone, inverse)


def lens_gain(segment: Segment, equations: Equations, solved: Reduced) -> Array:
    """Part (n, 2, 5) of the right side of the lens by each pixel of the residual of each tie."""
    e, early = equations, segment.early
    response = np.concatenate([np.zeros((6, len(LENS))), solved.by_lens, np.eye(len(LENS))])
    moved = -solved.inverse @ (e.cross @ response)
    by_pose, own, by_point = np.split(e.slopes, [6, 6 + len(LENS)], axis=2)
    poses = response[: -len(LENS)].reshape(-1, 6, len(LENS))
    by_lens = by_pose @ poses[segment.frame] + own + by_point @ moved[segment.track]
    by_tie = by_lens[early + 1] - _warps(segment.warp) @ by_lens[early]
    return np.asarray(by_tie * e.weight[:, None, None])


def updated(segment: Segment, equations: Equations, solved: Reduced, lens: Array) -> Segment:
    """The segment after a step of the lens by `lens` (5,)."""
    poses = np.concatenate([np.zeros(6), solved.alone + solved.by_lens @ lens])
    rest = equations.point_right - equations.cross @ np.concatenate([poses, lens])
    moves = poses.reshape(-1, 6)
    return segment._replace(
        rotations=segment.rotations @ Rotation.from_rotvec(moves[:, :3]).as_matrix(),
        centres=segment.centres + moves[:, 3:],
        points=segment.points + (solved.inverse @ rest[:, :, None])[:, :, 0],
    )


def _warps(warp: Array) -> Array:
    """Matrices (n, 2, 2) of warps (n, 3)."""
    matrices = np.zeros((len(warp), 2, 2))
    matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1] = warp.T
    return matrices


def _residuals(segment: Segment, pixels: Array) -> tuple[Array, Array]:
    """Residuals of points in the first image of their track (p, 2), and of ties (n, 2), px."""
    s = segment
    offset = pixels[s.early] - s.start
    mapped = s.end + (_warps(s.warp) @ offset[:, :, None])[:, :, 0]
    return offset[s.head], pixels[s.early + 1] - mapped


@compiled
def _accumulate(
    frame: Numbers,
    track: Numbers,
    late: Numbers,
    warp: Array,
    errors: Array,
    weights: Array,
    found: Equations,
) -> None:
    # Adds the equations of the anchors, then of the ties, `late`: pair in the later image. Columns of a row: pose of
    # the later image, of the earlier one, lens, point.
    points, lens = len(late) - len(warp), found.matrix.shape[0] - 5
    row, column = np.zeros((2, 20)), np.zeros(17, np.int64)
    for k in range(len(late)):
        own, at = weights[k], late[k]
        for i in range(2):
            for j in range(6):
                row[i, j], row[i, 6 + j] = own * found.slopes[at, i, j], 0.0
            for j in range(6, 14):
                row[i, 6 + j] = own * found.slopes[at, i, j]
        for j in range(6):
            column[j] = column[6 + j] = 6 * frame[at] + j
        if k >= points:
            a, b, d = warp[k - points]
            for j in range(14):
                x, y = own * found.slopes[at - 1, 0, j], own * found.slopes[at - 1, 1, j]
                row[0, 6 + j] -= a * x + b * y
                row[1, 6 + j] -= d * y
            for j in range(6):
                column[6 + j] = 6 * frame[at - 1] + j
        for j in range(5):
            column[12 + j] = lens + j
        _add_row(row, column, own * errors[k, 0], own * errors[k, 1], track[at], found)


@compiled_within
def _add_row(row: Array, column: Numbers, u: float, v: float, track: int, found: Equations) -> None:
    for i in range(17):
        x, y, at = row[0, i], row[1, i], column[i]
        found.right[at] -= x * u + y * v
        for j in range(i + 1):
            found.matrix[at, column[j]] += x * row[0, j] + y * row[1, j]
        for j in range(3):
            found.cross[track, j, at] += x * row[0, 17 + j] + y * row[1, 17 + j]
    for i in range(3):
        x, y = row[0, 17 + i], row[1, 17 + i]
        found.point_right[track, i] -= x * u + y * v
        for j in range(3):
            found.block[track, i, j] += x * row[0, 17 + j] + y * row[1, 17 + j]


def _prior_residuals(segment: Segment) -> tuple[Array, Array]:
    """Of the turns (m - 1, 3) and of the lengths (m - 1,) of the steps, in their sigmas."""
    s = segment
    gaps = (s.rotations[:-1] @ s.turns).transpose(0, 2, 1) @ s.rotations[1:]
    turns = Rotation.from_matrix(gaps).as_rotvec() / s.turn_sigma[:, None]  # 0 by inf
    found = np.linalg.norm(np.diff(s.centres, axis=0), axis=1)
    return turns, (found / s.lengths - 1) / LENGTH_SIGMA


def _add_priors(segment: Segment, matrix: Array, right: Array) -> None:
    s = segment
    turns, steps = _prior_residuals(s)
    gaps, count = np.diff(s.centres, axis=0), len(s.lengths)
    lengths = np.maximum(np.linalg.norm(gaps, axis=1), _FLOOR) * s.lengths * LENGTH_SIGMA
    rows = np.zeros((count, 4, 12))
    rows[:, :3, :3] = -(s.rotations[1:].transpose(0, 2, 1) @ s.rotations[:-1])
    rows[:, :3, 6:9] = np.eye(3)
    rows[:, :3] /= s.turn_sigma[:, None, None]  # inf: they weigh nothing
    rows[:, 3, 9:12] = gaps / lengths[:, None]
    rows[:, 3, 3:6] = -rows[:, 3, 9:12]
    turned, errors = rows.transpose(0, 2, 1), np.column_stack([turns, steps])[:, :, None]
    for k, (square, by_error) in enumerate(zip(turned @ rows, turned @ errors, strict=True)):
        both = slice(6 * k, 6 * k + 12)
        matrix[both, both] += square
        right[both] -= by_error[:, 0]
