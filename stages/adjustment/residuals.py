"""Residuals of a window of frames and their derivatives: observations of points, ties between frames, step constraints.

A tie is a registered patch. It does not measure where a point is; it measures which position in one image corresponds
to a position in another: a map, to first order an affine one. So its residual is the point's projection in the later
frame less the map of its projection in the earlier one. That links a point over three frames, although each step is
registered from a whole pixel and ends between pixels. The next step starts at the nearest keypoint, up to a pixel away,
and its map carries the difference on. The errors of a chain of ties stay those of its links, independent of each other.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.motion import StepPrior
from wayside.stages.geometry import halfway_direction, rotation_from_vector, vector_from_rotation
from wayside.stages.kernels import Array, compiled, require_array

QUADRATIC = 1e6
"""Scale of a cost that stays quadratic."""
DIFFERENCE = 1e-5
"""Step of central differences, radians and metres: what they leave out and the digits they lose are both below 1e-9."""
BEHIND, NEAREST = 1e12, 1e-3
"""Residual of a point behind a camera, and the smallest depth that counts as ahead, in units of the point's depth."""

Poses = tuple[Array, Array]


class ResidualBlocks(NamedTuple):
    """Residuals of points, two a row: ties of two frames, and observations in one frame.

    `frames` (m, 2): earlier and later frame (observation: the same twice). `point` (m,). `source`, `target` (m, 2):
    rays (x/z, y/z) of the patch in both. `warp` (m, 3): stretch along u, shear of u by v, stretch along v from the
    earlier to the later image (observation: 0). `sigma` (m,): of the target, unit of the rays. `scale` (m,): sigmas
    where the Cauchy cost starts to flatten.
    """

    frames: NDArray[np.int64]
    point: NDArray[np.int64]
    source: Array
    target: Array
    warp: Array
    sigma: Array
    scale: Array

    @staticmethod
    def observations(
        frame: NDArray[np.int64], point: NDArray[np.int64], ray: Array, sigma: Array, scale: float
    ) -> "ResidualBlocks":
        """Observations of points in single frames."""
        n = len(frame)
        return ResidualBlocks(
            np.column_stack([frame, frame]),
            point,
            np.zeros((n, 2)),
            np.ascontiguousarray(ray, np.float64),
            np.zeros((n, 3)),
            np.ascontiguousarray(sigma, np.float64),
            np.full(n, scale),
        )

    @staticmethod
    def joined(parts: "list[ResidualBlocks]") -> "ResidualBlocks":
        """The blocks of all parts, in order."""
        return ResidualBlocks(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class StepConstraints(NamedTuple):
    """What is known of steps beforehand, as in `schemas.motion.StepPrior`.

    `frames` (l, 2): from, to. `rotation` (l, 3, 3), `sigma_rotation` (l,) rad, inf: unknown. `direction` (l, 3) of
    travel, sigma_direction (l, 2) as slopes. `halfway` (l,): in the axes half way through the rotation. `length`,
    `sigma_length` (l,), m.
    """

    frames: NDArray[np.int64]
    rotation: Array
    sigma_rotation: Array
    direction: Array
    sigma_direction: Array
    halfway: NDArray[np.bool_]
    length: Array
    sigma_length: Array

    @staticmethod
    def of(priors: Sequence[StepPrior], *, common: bool = False) -> "StepConstraints":
        """Priors of the steps of a window, each from one frame to the next.

        `common`: their lengths derive from each other, so they share one error, which does not average out.
        """
        numbers = np.arange(len(priors), dtype=np.int64)
        factor = np.sqrt(len(priors)) if common else 1.0
        return StepConstraints(
            np.column_stack([numbers, numbers + 1]),
            np.array([p.rotation for p in priors], np.float64).reshape(-1, 3, 3),
            np.array([p.sigma_rotation for p in priors], np.float64),
            np.array([p.direction for p in priors], np.float64).reshape(-1, 3),
            np.array([p.sigma_direction for p in priors], np.float64).reshape(-1, 2),
            np.array([p.halfway for p in priors], np.bool_),
            np.array([p.length_m for p in priors], np.float64),
            np.array([p.sigma_m * factor for p in priors], np.float64),
        )


class WindowEstimate(NamedTuple):
    """Poses, points, residuals of the blocks (m, 2) and of the constraints (l, 6).

    `by_pose` (m, 2, 12), `by_point` (m, 2, 3): derivatives of the residuals of the blocks.
    """

    rotations: Array
    centres: Array
    points: Array
    residuals: Array
    step_residuals: Array
    by_pose: Array
    by_point: Array


class PointAnchors(NamedTuple):
    """Frames of the points' coordinates: rotation (p, 3, 3) and centre (p, 3) of a camera that sees each point.

    A point is `(a, b, rho)`: the ray `(a, b, 1)` of that camera as posed at the start, and the inverse depth there. The
    anchor stays while the camera's pose is adjusted, so a point depends on no pose.
    """

    rotation: Array
    centre: Array


_KINDS = {"frames": np.int64, "point": np.int64, "halfway": np.bool_}
_WIDTHS: dict[str, tuple[int, ...]] = {"warp": (3,), "direction": (3,), "rotation": (3, 3)}
_WIDTHS |= dict.fromkeys(("frames", "source", "target", "sigma_direction"), (2,))


def require_rows(rows: ResidualBlocks | StepConstraints, **below: int) -> None:
    """Refuse columns of another kind, shape or number of rows than compiled code takes.

    below: what the numbers of a column are below. Raises ValueError.
    """
    for name, column in zip(rows._fields, rows, strict=True):
        shape = (len(rows.frames), *_WIDTHS.get(name, ()))
        require_array(column, name, _KINDS.get(name, np.float64), shape)
    for name, count in below.items():
        numbers = getattr(rows, name)
        if len(numbers) and not (0 <= numbers.min() and numbers.max() < count):
            found = f"{numbers.min()} to {numbers.max()}"
            raise ValueError(f"{name}: {found} is outside 0 to {count - 1}")


@compiled
def linearise_blocks(
    estimate: WindowEstimate, anchors: PointAnchors, blocks: ResidualBlocks
) -> float:
    """Fill the residuals in sigmas and their derivatives at the poses and points; returns the robust cost.

    By a rotation of a pose (rad, world axes) and its centre, earlier pose first; by the point (eq. 7.6). Residuals are
    very large where a point lies behind a camera.
    """
    rotations, centres, points, residuals, _, by_pose, by_point = estimate
    total, ray, slope = 0.0, np.zeros((2, 2)), np.zeros((2, 2, 9))
    v, g = np.empty(3), np.empty(3)
    for i in range(residuals.shape[0]):
        n, observation, ahead = blocks.point[i], blocks.frames[i, 0] == blocks.frames[i, 1], True
        a, b, rho = points[n, 0], points[n, 1], points[n, 2]
        for x in range(int(observation), 2):
            f = blocks.frames[i, x]
            for k in range(3):
                v[k] = anchors.rotation[n, k, 0] * a + anchors.rotation[n, k, 1] * b
                v[k] += anchors.rotation[n, k, 2] + rho * (anchors.centre[n, k] - centres[f, k])
            z = rotations[f, 0, 2] * v[0] + rotations[f, 1, 2] * v[1] + rotations[f, 2, 2] * v[2]
            ahead = ahead and z > NEAREST
            z = max(z, NEAREST)
            for c in range(2):
                # by the point's position v, world axes; a rotation w of the camera moves it there by v x w
                at = 0.0
                for k in range(3):
                    at += rotations[f, k, c] * v[k] / z
                for k in range(3):
                    g[k] = (rotations[f, k, c] - at * rotations[f, k, 2]) / z
                ray[x, c], part = at, slope[x, c]
                part[0] = g[1] * v[2] - g[2] * v[1]
                part[1] = g[2] * v[0] - g[0] * v[2]
                part[2] = g[0] * v[1] - g[1] * v[0]
                part[6] = part[7] = part[8] = 0.0
                for k in range(3):
                    part[3 + k] = -rho * g[k]
                    part[6] += g[k] * anchors.rotation[n, k, 0]
                    part[7] += g[k] * anchors.rotation[n, k, 1]
                    part[8] += g[k] * (anchors.centre[n, k] - centres[f, k])
        weight, square = 1.0 / blocks.sigma[i], 0.0
        for c in range(2):
            own, other = blocks.warp[i, 2 * c], 0.0 if c else blocks.warp[i, 1]
            gap = own * (ray[0, c] - blocks.source[i, c])
            gap += other * (ray[0, 1] - blocks.source[i, 1])
            residuals[i, c] = weight * (ray[1, c] - blocks.target[i, c] - gap) if ahead else BEHIND
            square += residuals[i, c] * residuals[i, c]
            for k in range(9):
                early = 0.0 if observation else own * slope[0, c, k] + other * slope[0, 1, k]
                if k < 6:
                    by_pose[i, c, k] = -weight * early
                    by_pose[i, c, 6 + k] = weight * slope[1, c, k]
                else:
                    by_point[i, c, k - 6] = weight * (slope[1, c, k] - early)
        scale = blocks.scale[i] * blocks.scale[i]
        total += scale * np.log1p(square / scale)
    return total


@compiled
def constraint_residuals(
    rotations: Array, centres: Array, constraints: StepConstraints, residuals: Array
) -> None:
    """Residuals (l, 6) of step constraints, in sigmas: rotation, direction sideways and up, length."""
    turn, off, travel = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for i in range(residuals.shape[0]):
        first, second = constraints.frames[i, 0], constraints.frames[i, 1]
        for k in range(3):
            travel[k] = 0.0
            for j in range(3):
                turn[k, j] = 0.0
                for c in range(3):
                    turn[k, j] += rotations[first, c, k] * rotations[second, c, j]
                travel[k] += rotations[first, j, k] * (centres[second, j] - centres[first, j])
            for j in range(3):
                off[k, j] = 0.0
                for c in range(3):
                    off[k, j] += turn[k, c] * constraints.rotation[i, j, c]
        vector, expected = vector_from_rotation(off), constraints.direction[i]
        if constraints.halfway[i]:
            expected = halfway_direction(turn, expected)
        square = 0.0
        for k in range(3):
            residuals[i, k] = vector[k] / constraints.sigma_rotation[i]
            square += travel[k] * travel[k]
        for k in range(2):
            slope = travel[k] / travel[2] - expected[k] / expected[2]
            residuals[i, 3 + k] = slope / constraints.sigma_direction[i, k]
        residuals[i, 5] = (np.sqrt(square) - constraints.length[i]) / constraints.sigma_length[i]


@compiled
def move_poses(step: Array, poses: Poses, moved: Poses) -> None:
    """Fill poses (n, 3, 3), (n, 3) moved by `step` (6 n,): rotation vector in world axes and shift of each."""
    for f in range(poses[0].shape[0]):
        turn = rotation_from_vector(step[6 * f : 6 * f + 3])
        for i in range(3):
            moved[1][f, i] = poses[1][f, i] + step[6 * f + 3 + i]
            for j in range(3):
                moved[0][f, i, j] = 0.0
                for k in range(3):
                    moved[0][f, i, j] += turn[i, k] * poses[0][f, k, j]


@compiled
def constraint_jacobian(poses: Poses, constraints: StepConstraints, jacobian: Array) -> None:
    """Fill the central differences (6 l, 6 n) of the residuals of all constraints by the poses."""
    moved = np.empty_like(poses[0]), np.empty_like(poses[1])
    step, found = np.zeros(jacobian.shape[1]), np.empty((2, len(jacobian)))
    for k in range(len(step)):
        for side in range(2):
            step[k] = DIFFERENCE if side else -DIFFERENCE
            move_poses(step, poses, moved)
            rows = found[side].reshape(len(jacobian) // 6, 6)
            constraint_residuals(moved[0], moved[1], constraints, rows)
        step[k] = 0.0
        for i in range(len(jacobian)):
            jacobian[i, k] = (found[1, i] - found[0, i]) / (2 * DIFFERENCE)
