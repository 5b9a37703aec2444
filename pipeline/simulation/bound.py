"""Cramér-Rao bound of a located point: the smallest covariance of any unbiased estimate from the measurements."""

import numpy as np

from wayside.stages.geometry import cross_matrices, rotation_from_vector, tangent_basis
from wayside.stages.kernels import Array, Numbers
from wayside.stages.odometry import sampson_px

DIFFERENCE_STEP = 1e-6
"""Step of forward differences, radians: half of the digits of a double."""


def motion_jacobian(
    previous: Array, current: Array, rotation: Array, direction: Array, focal_px: float
) -> Array:
    """Derivatives (n, 5) of the Sampson distances of rays (n, 2), px, by the motion.

    The motion's five coordinates are the rotation vector and the direction along `tangent_basis`, radians.
    """
    distances = sampson_px(previous, current, rotation, direction, focal_px)
    basis, columns = tangent_basis(direction), []
    for single in DIFFERENCE_STEP * np.eye(5):
        moved = direction + single[3:] @ basis
        turned = rotation_from_vector(single[:3]) @ rotation
        there = sampson_px(previous, current, turned, moved / np.linalg.norm(moved), focal_px)
        columns.append((there - distances) / DIFFERENCE_STEP)
    return np.column_stack(columns)


def step_bound(
    jacobian: Array, covariance: Array, direction: Array, baseline_m: float, sigma_m: float
) -> Array:
    """Smallest covariance (6, 6) of a step by ties: rotation vector, then translation, in the first camera's axes.

    `jacobian` (n, 5), `covariance` (n, n): of the ties' Sampson distances, px, as from `motion_jacobian`.
    `direction` (3,): of travel, unit. `baseline_m`, `sigma_m`: length of the step and its prior standard deviation.
    """
    motion = np.linalg.inv(jacobian.T @ np.linalg.solve(covariance, jacobian))
    spread = np.zeros((6, 5))
    spread[:3, :3] = np.eye(3)
    spread[3:, 3:] = baseline_m * tangent_basis(direction).T
    result = spread @ motion @ spread.T
    result[3:, 3:] += sigma_m**2 * np.outer(direction, direction)
    return np.asarray((result + result.T) / 2)


def point_bound(
    rotations: Array,
    centres: Array,
    point: Array,
    views: Numbers,
    sigma: Array,
    steps: Array,
    best: int,
    pose_sigma: tuple[float, float] | None = None,
) -> Array:
    """Smallest covariance (3, 3) of a point in the camera frame of frame `best`, square metres.

    Inverse of the Fisher information of poses and point, poses eliminated (projection: report eq. 7.6).
    `rotations` (n, 3, 3), `centres` (n, 3), `point` (3,): true, in the world, of consecutive frames.
    `views` (v,), `sigma` (v,): frames that show the point, and standard deviation of their rays (x/z, y/z).
    `steps` (n, 6, 6): covariance of the step from the frame before, as from `step_bound`; row 0 is not used.
    `pose_sigma`: of given poses, metres and radians; None without given poses.
    """
    n = len(rotations)
    # unknowns: rotation vector and shift of each camera, world axes; then the point
    information = np.zeros((6 * n + 3, 6 * n + 3))
    for k in range(1, n):
        back = rotations[k - 1].T
        rows = np.zeros((6, 6 * n + 3))
        rows[:3, 6 * k - 6 : 6 * k - 3], rows[:3, 6 * k : 6 * k + 3] = -back, back
        rows[3:, 6 * k - 3 : 6 * k], rows[3:, 6 * k + 3 : 6 * k + 6] = -back, back
        rows[3:, 6 * k - 6 : 6 * k - 3] = back @ cross_matrices(centres[k] - centres[k - 1])
        information += rows.T @ np.linalg.solve(steps[k], rows)
    for view, spread in zip(views, sigma, strict=True):
        rows = _local_rows(rotations[view], centres[view], point, int(view), n)
        x, y, z = (point - centres[view]) @ rotations[view]
        project = np.array([[1 / z, 0, -x / z**2], [0, 1 / z, -y / z**2]]) / spread
        information += (project @ rows).T @ (project @ rows)
    keep = np.ones(6 * n + 3, np.bool_)
    if pose_sigma is None:
        keep[6 * best : 6 * best + 6] = False  # the pose of the drive as a whole is not measured
    else:
        diagonal = np.tile([pose_sigma[1] ** -2] * 3 + [pose_sigma[0] ** -2] * 3, n)
        information[np.arange(6 * n), np.arange(6 * n)] += diagonal
    report = _local_rows(rotations[best], centres[best], point, best, n)[:, keep]
    return np.asarray(report @ np.linalg.solve(information[np.ix_(keep, keep)], report.T))


def _local_rows(rotation: Array, centre: Array, point: Array, frame: int, n: int) -> Array:
    """Derivative (3, 6 n + 3) of a point in a camera's frame by all unknowns."""
    rows = np.zeros((3, 6 * n + 3))
    rows[:, 6 * frame : 6 * frame + 3] = rotation.T @ cross_matrices(point - centre)
    rows[:, 6 * frame + 3 : 6 * frame + 6] = -rotation.T
    rows[:, -3:] = rotation.T
    return rows
