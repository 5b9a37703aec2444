"""Covariance of a point by the errors of its rays and of the motion between them; the latter is the larger part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import cross_matrices


def point_covariance(
    rotations: NDArray[np.float64],
    centres: NDArray[np.float64],
    point: NDArray[np.float64],
    views: NDArray[np.int64],
    weight_sigma: NDArray[np.float64],
    ray_sigma: NDArray[np.float64],
    steps: NDArray[np.float64],
    best: int,
) -> NDArray[np.float64]:
    """Covariance (3, 3) of a point relative to the camera of frame `best`, in world axes, square metres.

    First-order propagation (report chapter 8's projection, eq. 7.6): the estimate moves by the gain
    (J' W J)^-1 J' W times the error of the rays; an error of the step between two frames moves all views on the far
    side of it, seen from `best`, together.

    Parameters
    ----------
    rotations, centres
        World from camera (n, 3, 3) and camera centres (n, 3) of consecutive frames.
    point
        (3,) in the world.
    views
        Frames (v,) that the point was fitted to.
    weight_sigma, ray_sigma
        Standard deviation (v,) the views were weighted by, and that of the measured rays alone.
    steps
        Covariance (n, 6, 6) of the step from the frame before (rotation vector, rad, then translation, m, in the
        earlier camera's frame); row 0 is not used.
    best
        The frame the point is reported in.
    """
    local = np.einsum("ni,nij->nj", point - centres[views], rotations[views])
    depth = local[:, 2]
    project = np.zeros((len(views), 2, 3))
    project[:, 0, 0] = project[:, 1, 1] = 1 / depth
    project[:, :, 2] = -local[:, :2] / depth[:, None] ** 2
    jacobian = project @ rotations[views].transpose(0, 2, 1)
    weight = 1 / weight_sigma**2
    information = np.einsum("v,vki,vkj->ij", weight, jacobian, jacobian)
    gain = np.linalg.inv(information) @ (weight[:, None, None] * jacobian.transpose(0, 2, 1))
    covariance: NDArray[np.float64] = np.einsum("v,vik,vjk->ij", ray_sigma**2, gain, gain)
    low, high = min(int(views.min()), best), max(int(views.max()), best)
    for step in range(low + 1, high + 1):
        beyond = views < step if step <= best else views >= step
        if not beyond.any():
            continue
        before = rotations[step - 1]
        lever_arm = (point - centres[step]) @ before
        by_step = before @ np.concatenate([-cross_matrices(lever_arm), np.eye(3)], axis=1)
        effect = np.einsum("vik,vkj->ij", gain[beyond], jacobian[beyond]) @ by_step
        covariance += effect @ steps[step] @ effect.T
    return (covariance + covariance.T) / 2
