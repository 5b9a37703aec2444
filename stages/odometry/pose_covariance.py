"""How exactly a step is known: the noise of its ties, and the errors that neighbouring ties share."""

from __future__ import annotations

import numpy as np

from wayside.stages.geometry import tangent_basis
from wayside.stages.kernels import Array
from wayside.stages.odometry.correlated_errors import correlated_motion_covariance, motion_jacobian
from wayside.stages.odometry.tie_points import REGISTERED_SIGMA_PX
from wayside.stages.odometry.two_view_adjustment import TwoViewAdjustment

CORRELATED_SIGMA_PX, CORRELATED_FRACTION, CORRELATION_REACH_PX = 0.05, 0.004, 60.0
"""Error that neighbouring ties have in common, what their way through the picture adds, and how far it reaches: so far
do rotations and directions scatter (measured). Directions hang on a few near ties, mostly on the road, that slide along
markings or confirm the motion they were sought by."""


def correlated_sigma_px(way_px: Array) -> Array:
    """Scatter (n,) of the error that ties share with their neighbours, by their way through the picture."""
    return np.asarray(CORRELATED_SIGMA_PX + CORRELATED_FRACTION * way_px)


def parallax_px(adjusted: TwoViewAdjustment, focal_px: float) -> Array:
    """Way of each tie (n,) through the picture by the travel alone, pixels."""
    away = adjusted.point[:, :2] - adjusted.direction[:2] / adjusted.direction[2]
    return np.asarray(focal_px * np.maximum(adjusted.point[:, 2], 0) * np.linalg.norm(away, axis=1))


def relative_pose_covariance(
    adjusted: TwoViewAdjustment,
    rays: tuple[Array, Array],
    focal_px: tuple[float, float],
    baseline_m: float,
    sigma_m: float,
    *,
    scale_px: float,
) -> Array:
    """Covariance (6, 6) of rotation vector and translation in the previous camera's axes.

    Parameters
    ----------
    adjusted
        The step as adjusted to the rays (n, 2) of both pictures.
    rays
        These.
    focal_px
        fx, fy.
    baseline_m, sigma_m
        Length of the step and its standard deviation.
    scale_px
        Where the cost of a tie starts to flatten.
    """
    focal = 0.5 * (focal_px[0] + focal_px[1])
    gaps, slopes = motion_jacobian(*rays, adjusted.rotation, adjusted.direction, focal)
    weight = 1 / (REGISTERED_SIGMA_PX**2 * (1 + (gaps / scale_px) ** 2))
    shared = correlated_motion_covariance(
        rays[1],
        adjusted.rotation.T @ adjusted.direction,
        adjusted.covariance @ (slopes * weight[:, None]).T,
        focal_px=focal,
        sigma_px=correlated_sigma_px(parallax_px(adjusted, focal)),
        reach_px=CORRELATION_REACH_PX,
    )
    basis = tangent_basis(adjusted.direction)
    spread = np.zeros((6, 5))
    spread[:3, :3] = np.eye(3)
    spread[3:, 3:] = baseline_m * basis.T
    covariance = spread @ (adjusted.covariance + shared) @ spread.T
    covariance[3:, 3:] += sigma_m**2 * np.outer(adjusted.direction, adjusted.direction)
    return np.asarray(covariance)
