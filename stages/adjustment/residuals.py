"""Residuals of a window of frames and their derivatives: observations of points, ties between frames, step constraints.

A tie is a registered patch. It does not measure where a point is; it measures which position in one image corresponds
to a position in another: a map, to first order an affine one. So its residual is the point's projection in the later
frame less the map of its projection in the earlier one. That links a point over three frames, although each step is
registered from a whole pixel and ends between pixels. The next step starts at the nearest keypoint, up to a pixel away,
and its map carries the difference on. The errors of a chain of ties stay those of its links, independent of each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.motion import StepPrior
from wayside.stages.geometry import (
    halfway_direction,
    rotation_from_vector,
    vector_from_rotation,
)
from wayside.stages.kernels import Array, compiled, require_array

QUADRATIC = 1e6
"""Scale of a cost that stays quadratic."""
DIFFERENCE = 1e-5
"""Step of central differences, radians and metres: what they leave out and the digits they lose are both below 1e-9."""
BEHIND, NEAREST = 1e12, 1e-3
"""Residual of a point behind a camera, and the smallest depth that counts as ahead, in units of the point's depth."""


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
    ) -> ResidualBlocks:
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
    def joined(parts: list[ResidualBlocks]) -> ResidualBlocks:
        """The blocks of all parts, in order."""
        return ResidualBlocks(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def checked(self, frames: int, points: int) -> ResidualBlocks:
        """The same; ValueError where compiled code would read outside of an array."""
        _require_rows(self)
        _require_below(self.frames, "frames", frames)
        _require_below(self.point, "point", points)
        return self


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
    def of(priors: Sequence[StepPrior], *, common: bool = False) -> StepConstraints:
        """Priors of the steps of a window, each from one frame to the next.

        common: their lengths derive from each other, so they share one error, which does not average out.
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

    def checked(self, frames: int) -> StepConstraints:
        """The same; ValueError where compiled code would read outside of an array."""
        _require_rows(self)
        _require_below(self.frames, "frames", frames)
        return self


class PointAnchors(NamedTuple):
    """Frames of the points' coordinates: rotation (p, 3, 3) and centre (p, 3) of a camera that sees each point.

    A point is (a, b, rho): the ray (a, b, 1) of that camera as posed at the start, and the inverse depth there. The
    anchor stays while the camera's pose is adjusted, so a point depends on no pose.
    """

    rotation: Array
    centre: Array


_KINDS = {"frames": np.int64, "point": np.int64, "halfway": np.bool_}
_WIDTHS: dict[str, tuple[int, ...]] = {
    "frames": (2,),
    "source": (2,),
    "target": (2,),
    "warp": (3,),
    "direction": (3,),
}
_WIDTHS |= {"rotation": (3, 3), "sigma_direction": (2,)}


def _require_rows(rows: ResidualBlocks | StepConstraints) -> None:
    """Refuse columns of another kind, shape or number of rows than compiled code takes."""
    for name, column in zip(rows._fields, rows, strict=True):
        shape = (len(rows.frames), *_WIDTHS.get(name, ()))
        require_array(column, name, _KINDS.get(name, np.float64), shape)


def _require_below(numbers: NDArray[np.int64], name: str, count: int) -> None:
    if len(numbers) and not (0 <= numbers.min() and numbers.max() < count):
        raise ValueError(f"{name}: {numbers.min()} to {numbers.max()} is outside 0 to {count - 1}")


@compiled
def project(
    rotation: Array, centre: Array, anchor_r: Array, anchor_c: Array, point: Array, ray: Array
) -> bool:
    """Ray (2,) of a point in a camera (eq. 7.6); False where it lies behind."""
    v0 = anchor_r[0, 0] * point[0] + anchor_r[0, 1] * point[1] + anchor_r[0, 2]
    v1 = anchor_r[1, 0] * point[0] + anchor_r[1, 1] * point[1] + anchor_r[1, 2]
    v2 = anchor_r[2, 0] * point[0] + anchor_r[2, 1] * point[1] + anchor_r[2, 2]
    v0 += point[2] * (anchor_c[0] - centre[0])
    v1 += point[2] * (anchor_c[1] - centre[1])
    v2 += point[2] * (anchor_c[2] - centre[2])
    z = rotation[0, 2] * v0 + rotation[1, 2] * v1 + rotation[2, 2] * v2
    ahead: bool = z > NEAREST
    z = max(z, NEAREST)
    ray[0] = (rotation[0, 0] * v0 + rotation[1, 0] * v1 + rotation[2, 0] * v2) / z
    ray[1] = (rotation[0, 1] * v0 + rotation[1, 1] * v1 + rotation[2, 1] * v2) / z
    return ahead


@compiled
def project_jacobian(
    rotation: Array, centre: Array, anchor_r: Array, anchor_c: Array, point: Array, jacobian: Array
) -> None:
    """Derivatives (2, 9) of `project`: by a rotation (rad, world axes), by the centre, by the point."""
    r, rho = rotation, point[2]
    a0, a1, a2 = anchor_c[0] - centre[0], anchor_c[1] - centre[1], anchor_c[2] - centre[2]
    v0 = anchor_r[0, 0] * point[0] + anchor_r[0, 1] * point[1] + anchor_r[0, 2] + rho * a0
    v1 = anchor_r[1, 0] * point[0] + anchor_r[1, 1] * point[1] + anchor_r[1, 2] + rho * a1
    v2 = anchor_r[2, 0] * point[0] + anchor_r[2, 1] * point[1] + anchor_r[2, 2] + rho * a2
    z = max(r[0, 2] * v0 + r[1, 2] * v1 + r[2, 2] * v2, NEAREST)
    for i in range(2):
        # by the point's position v, world axes; a rotation w of the camera moves it in the camera's axes by v x w
        slope = (r[0, i] * v0 + r[1, i] * v1 + r[2, i] * v2) / z
        g0 = (r[0, i] - slope * r[0, 2]) / z
        g1 = (r[1, i] - slope * r[1, 2]) / z
        g2 = (r[2, i] - slope * r[2, 2]) / z
        jacobian[i, 0], jacobian[i, 1], jacobian[i, 2] = (
            g1 * v2 - g2 * v1,
            g2 * v0 - g0 * v2,
            g0 * v1 - g1 * v0,
        )
        jacobian[i, 3], jacobian[i, 4], jacobian[i, 5] = -rho * g0, -rho * g1, -rho * g2
        jacobian[i, 6] = g0 * anchor_r[0, 0] + g1 * anchor_r[1, 0] + g2 * anchor_r[2, 0]
        jacobian[i, 7] = g0 * anchor_r[0, 1] + g1 * anchor_r[1, 1] + g2 * anchor_r[2, 1]
        jacobian[i, 8] = g0 * a0 + g1 * a1 + g2 * a2


@compiled
def block_residuals(
    rotations: Array,
    centres: Array,
    anchors: PointAnchors,
    points: Array,
    blocks: ResidualBlocks,
    residuals: Array,
) -> None:
    """Residuals (m, 2) in sigmas; very large where a point lies behind a camera."""
    before, now = np.empty(2), np.empty(2)
    for i in range(blocks.point.shape[0]):
        n, first, second = blocks.point[i], blocks.frames[i, 0], blocks.frames[i, 1]
        anchor_r, anchor_c = anchors.rotation[n], anchors.centre[n]
        ahead = project(rotations[second], centres[second], anchor_r, anchor_c, points[n], now)
        ahead &= project(rotations[first], centres[first], anchor_r, anchor_c, points[n], before)
        if not ahead:
            residuals[i] = BEHIND
            continue
        u, v = before[0] - blocks.source[i, 0], before[1] - blocks.source[i, 1]
        w = blocks.warp[i]
        residuals[i, 0] = (now[0] - blocks.target[i, 0] - w[0] * u - w[1] * v) / blocks.sigma[i]
        residuals[i, 1] = (now[1] - blocks.target[i, 1] - w[2] * v) / blocks.sigma[i]


@compiled
def block_jacobian(  # noqa: PLR0913 - arrays of a kernel
    rotations: Array,
    centres: Array,
    anchors: PointAnchors,
    points: Array,
    blocks: ResidualBlocks,
    i: int,
    work: Array,
    jacobian: Array,
    point_jacobian: Array,
) -> None:
    """Derivatives of residual i, in sigmas: (2, 12) by both its poses, earlier first, and (2, 3) by its point.

    work (2, 2, 9): scratch.
    """
    n, first, second = blocks.point[i], blocks.frames[i, 0], blocks.frames[i, 1]
    anchor_r, anchor_c = anchors.rotation[n], anchors.centre[n]
    early, late = work[0], work[1]
    project_jacobian(rotations[second], centres[second], anchor_r, anchor_c, points[n], late)
    if first == second:
        early[:] = 0.0
    else:
        project_jacobian(rotations[first], centres[first], anchor_r, anchor_c, points[n], early)
    w0, w1, w2 = blocks.warp[i, 0], blocks.warp[i, 1], blocks.warp[i, 2]
    weight = 1.0 / blocks.sigma[i]
    for k in range(6):
        jacobian[0, k] = -weight * (w0 * early[0, k] + w1 * early[1, k])
        jacobian[1, k] = -weight * w2 * early[1, k]
        jacobian[0, 6 + k] = weight * late[0, k]
        jacobian[1, 6 + k] = weight * late[1, k]
    for k in range(3):
        point_jacobian[0, k] = weight * (
            late[0, 6 + k] - w0 * early[0, 6 + k] - w1 * early[1, 6 + k]
        )
        point_jacobian[1, k] = weight * (late[1, 6 + k] - w2 * early[1, 6 + k])


@compiled
def constraint_residuals(
    rotations: Array, centres: Array, constraints: StepConstraints, residuals: Array
) -> None:
    """Residuals (l, 6) of step constraints, in sigmas: rotation, direction sideways and up, length."""
    for i in range(constraints.frames.shape[0]):
        _step_residuals(rotations, centres, constraints, i, residuals[i])


@compiled
def _step_residuals(
    rotations: Array, centres: Array, constraints: StepConstraints, i: int, residuals: Array
) -> None:
    first, second = constraints.frames[i, 0], constraints.frames[i, 1]
    back = rotations[first].T
    rotation = np.dot(back, rotations[second])
    travel = np.dot(back, centres[second] - centres[first])
    vector = vector_from_rotation(np.dot(rotation, constraints.rotation[i].T))
    expected = constraints.direction[i]
    if constraints.halfway[i]:
        expected = halfway_direction(rotation, expected)
    for k in range(3):
        residuals[k] = vector[k] / constraints.sigma_rotation[i]
    for k in range(2):
        slope = travel[k] / travel[2] - expected[k] / expected[2]
        residuals[3 + k] = slope / constraints.sigma_direction[i, k]
    length = np.sqrt(travel[0] ** 2 + travel[1] ** 2 + travel[2] ** 2)
    residuals[5] = (length - constraints.length[i]) / constraints.sigma_length[i]


@compiled
def constraint_jacobian(
    rotations: Array, centres: Array, constraints: StepConstraints, i: int, jacobian: Array
) -> None:
    """Central differences (6, 12) of the residuals of constraint i by both poses, first one first.

    A window has few steps, so theirs cost little; derivatives of the blocks, which are hundreds, are in closed form.
    """
    after, before, step = np.empty(6), np.empty(6), np.empty(6)
    for x in range(2):
        frame = constraints.frames[i, x]
        rotation, centre = rotations[frame].copy(), centres[frame].copy()
        for k in range(6):
            for residuals, size in ((after, DIFFERENCE), (before, -DIFFERENCE)):
                step[:] = 0.0
                step[k] = size
                rotations[frame] = np.dot(rotation_from_vector(step[:3]), rotation)
                centres[frame] = centre + step[3:]
                _step_residuals(rotations, centres, constraints, i, residuals)
            jacobian[:, 6 * x + k] = (after - before) / (2 * DIFFERENCE)
        rotations[frame], centres[frame] = rotation, centre
