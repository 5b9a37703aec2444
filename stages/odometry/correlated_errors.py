"""Errors that neighbouring ties share, and what they do to the motion: no residual shows them.

Patches near each other lie on the same surface and under the same part of the lens: they are off together. The part
of such a field that looks like motion is fitted away, so it can only be stated beforehand.
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

    The motion's five coordinates are those of `numerics.adjust`: rotation vector, then direction along `tangent_basis`.
    """
    rotation, direction = np.ascontiguousarray(rotation), np.ascontiguousarray(direction)
    gaps = sampson_px(previous, current, rotation, direction, focal_px)
    slopes = np.empty((len(gaps), 5))
    basis, single = tangent_basis(direction), np.zeros(5)
    turned, moved = np.empty((3, 3)), np.empty(3)
    for k in range(5):
        single[:] = 0.0
        single[k] = DIFFERENCE_STEP
        updated_pose(rotation, direction, basis, single, turned, moved)
        slopes[:, k] = (
            sampson_px(previous, current, turned, moved, focal_px) - gaps
        ) / DIFFERENCE_STEP
    return gaps, slopes


def correlated_motion_covariance(
    current: Array, toward: Array, gain: Array, *, focal_px: float, sigma_px: Array, reach_px: float
) -> Array:
    """Covariance (5, 5) of the motion by a smooth random field of errors in the second picture.

    The field is Gaussian: a coordinate scatters by sigma_px (n,) at each tie, with correlation
    exp(-d^2 / (2 reach_px^2)) at a distance d. A tie feels its part across the epipolar line, and Sampson's distance,
    which both pictures share, half of its variance.

    Parameters
    ----------
    current
        Rays (n, 2) of the ties in the second picture.
    toward
        Direction of travel (3,) in the axes of the second camera: epipolar lines run away from it.
    gain
        Motion over the Sampson distance of each tie, (5, n), rad a pixel.
    """
    outward = current - toward[:2] / toward[2]
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-9)[:, None]
    result, felt = np.zeros((5, 5)), np.ascontiguousarray((gain * sigma_px).T)
    _correlated_motion_covariance(
        np.ascontiguousarray(current * focal_px),
        np.ascontiguousarray(outward),
        felt,
        0.5 / reach_px**2,
        result,
    )
    return np.asarray(0.5 * result)


@compiled
def _correlated_motion_covariance(
    place: Array, outward: Array, gain: Array, sharpness: float, result: Array
) -> None:
    total = np.empty(5)
    for i in range(place.shape[0]):
        total[:] = 0.0
        for j in range(place.shape[0]):
            x, y = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]
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
    place: Array, picture: NDArray[np.int64], felt: Array, reach_px: float
) -> Array:
    """Covariance (3, 3) of a point by smooth random fields of errors, one in each picture, independent of each other.

    Parameters
    ----------
    place
        Where ties lie in their pictures, (n, 2) px.
    picture
        Which picture that is, (n,), ascending in runs.
    felt
        How far one standard deviation of the field at each tie moves the point, by both its coordinates, (n, 2, 3).
    reach_px
        Of the correlation exp(-d^2 / (2 reach_px^2)).
    """
    order = np.argsort(picture, kind="stable")
    first = np.flatnonzero(np.diff(picture[order], prepend=-1)).astype(np.int64)
    result = np.zeros((3, 3))
    _correlated_point_covariance(
        np.append(first, len(order)),
        np.ascontiguousarray(place[order]),
        np.ascontiguousarray(felt[order]),
        0.5 / reach_px**2,
        result,
    )
    return result


@compiled
def _correlated_point_covariance(
    first: NDArray[np.int64], place: Array, felt: Array, sharpness: float, result: Array
) -> None:
    for p in range(first.shape[0] - 1):
        for i in range(first[p], first[p + 1]):
            for j in range(first[p], i + 1):
                x, y = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]
                near = sharpness * (x * x + y * y)
                if near > 12.0:
                    continue
                alike = np.exp(-near) * (0.5 if i == j else 1.0)
                for k in range(3):
                    for m in range(3):
                        both = felt[i, 0, k] * felt[j, 0, m] + felt[i, 1, k] * felt[j, 1, m]
                        result[k, m] += alike * both
                        result[m, k] += alike * both
