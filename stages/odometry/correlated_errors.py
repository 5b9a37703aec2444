"""Effect of errors that neighbouring ties share on motion and points; residuals do not show it.

Patches near each other lie on the same surface and are imaged by the same part of the lens, so their errors are
correlated. The part of such a field of errors that resembles motion is absorbed by the fit, so its size is given.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import tangent_basis
from wayside.stages.kernels import Array, compiled
from wayside.stages.odometry.epipolar import DIFFERENCE_STEP, sampson_px, updated_pose


def motion_jacobian(
    previous: Array, current: Array, rotation: Array, direction: Array, focal_px: float
) -> tuple[Array, Array]:
    """Sampson distances (n,) of rays (n, 2), px, and their derivatives (n, 5) by the motion.

    The motion's five coordinates are those of `adjust_two_views`: rotation vector, then direction along
    `tangent_basis`.
    """
    rotation, direction = np.ascontiguousarray(rotation), np.ascontiguousarray(direction)
    distances = sampson_px(previous, current, rotation, direction, focal_px)
    jacobian = np.empty((len(distances), 5))
    basis, single = tangent_basis(direction), np.zeros(5)
    rotated, moved = np.empty((3, 3)), np.empty(3)
    for k in range(5):
        single[:] = 0.0
        single[k] = DIFFERENCE_STEP
        updated_pose(rotation, direction, basis, single, rotated, moved)
        jacobian[:, k] = (
            sampson_px(previous, current, rotated, moved, focal_px) - distances
        ) / DIFFERENCE_STEP
    return distances, jacobian


def correlated_motion_covariance(
    current: Array, toward: Array, gain: Array, *, focal_px: float, sigma_px: Array, reach_px: float
) -> Array:
    """Covariance (5, 5) of the motion by a smooth random field of errors in the second image.

    The field is Gaussian: a coordinate scatters by sigma_px (n,) at each tie, with correlation
    exp(-d^2 / (2 reach_px^2)) at a distance d. Only its component across the epipolar line changes the Sampson
    distance, which divides the error between both images: half of the variance counts.

    Parameters
    ----------
    current
        Rays (n, 2) of the ties in the second image.
    toward
        Direction of travel (3,) in the axes of the second camera: epipolar lines radiate from it.
    gain
        Derivative of the motion by the Sampson distance of each tie, (5, n), rad / px.
    focal_px
        Pixels of one unit of the rays.
    sigma_px, reach_px
        Of the field.
    """
    outward = current - toward[:2] / toward[2]
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-9)[:, None]
    result, effect = np.zeros((5, 5)), np.ascontiguousarray((gain * sigma_px).T)
    _correlated_motion_covariance(
        np.ascontiguousarray(current * focal_px),
        np.ascontiguousarray(outward),
        effect,
        0.5 / reach_px**2,
        result,
    )
    return np.asarray(0.5 * result)


@compiled
def _correlated_motion_covariance(
    position: Array, outward: Array, gain: Array, sharpness: float, result: Array
) -> None:
    total = np.empty(5)
    for i in range(position.shape[0]):
        total[:] = 0.0
        for j in range(position.shape[0]):
            x, y = position[i, 0] - position[j, 0], position[i, 1] - position[j, 1]
            near = sharpness * (x * x + y * y)
            if near < 12.0:
                alike = outward[i, 0] * outward[j, 0] + outward[i, 1] * outward[j, 1]
                alike *= np.exp(-near)
                for k in range(5):
                    total[k] += alike * gain[j, k]
        for k in range(5):
            for m in range(5):
                result[k, m] += gain[i, k] * total[m]


def correlated_point_covariance(
    position: Array, image: NDArray[np.int64], effect: Array, reach_px: float
) -> Array:
    """Covariance (3, 3) of a point by smooth random fields of errors, one in each image, independent of each other.

    Parameters
    ----------
    position
        Positions of ties in their images, (n, 2) px.
    image
        Number of that image, (n,).
    effect
        Change of the point by one standard deviation of the field in both coordinates of each tie, (n, 2, 3).
    reach_px
        Of the correlation exp(-d^2 / (2 reach_px^2)).
    """
    order = np.argsort(image, kind="stable")
    first = np.flatnonzero(np.diff(image[order], prepend=-1)).astype(np.int64)
    result = np.zeros((3, 3))
    _correlated_point_covariance(
        np.append(first, len(order)),
        np.ascontiguousarray(position[order]),
        np.ascontiguousarray(effect[order]),
        0.5 / reach_px**2,
        result,
    )
    return result


@compiled
def _correlated_point_covariance(
    first: NDArray[np.int64], position: Array, effect: Array, sharpness: float, result: Array
) -> None:
    for p in range(first.shape[0] - 1):
        for i in range(first[p], first[p + 1]):
            for j in range(first[p], i + 1):
                x, y = position[i, 0] - position[j, 0], position[i, 1] - position[j, 1]
                near = sharpness * (x * x + y * y)
                if near > 12.0:
                    continue
                alike = np.exp(-near) * (0.5 if i == j else 1.0)
                for k in range(3):
                    for m in range(3):
                        both = effect[i, 0, k] * effect[j, 0, m] + effect[i, 1, k] * effect[j, 1, m]
                        result[k, m] += alike * both
                        result[m, k] += alike * both
