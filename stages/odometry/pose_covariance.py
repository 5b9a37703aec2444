"""Covariance of a relative pose: noise of its ties, and the errors that neighbouring ties share."""

from __future__ import annotations

import numpy as np

from wayside.schemas.settings import TieSettings
from wayside.stages.geometry import tangent_basis
from wayside.stages.kernels import Array
from wayside.stages.odometry.correlated_errors import correlated_motion_covariance, motion_jacobian
from wayside.stages.odometry.two_view_adjustment import TwoViewAdjustment


def correlated_sigma_px(displacement_px: Array, settings: TieSettings) -> Array:
    """Scatter (n,) of the error that ties share with their neighbours, by their displacement through travel, pixels.

    Directions of travel depend on few near ties, mostly on the road, which slide along markings or are biased towards
    the motion by which they were searched for.
    """
    return np.asarray(settings.correlated_sigma_px + settings.correlated_fraction * displacement_px)


def parallax_px(adjusted: TwoViewAdjustment, focal_px: float) -> Array:
    """Displacement (n,) of each tie in the image by travel alone, pixels."""
    offset = adjusted.point[:, :2] - adjusted.direction[:2] / adjusted.direction[2]
    return np.asarray(
        focal_px * np.maximum(adjusted.point[:, 2], 0) * np.linalg.norm(offset, axis=1)
    )


def relative_pose_covariance(
    adjusted: TwoViewAdjustment,
    rays: tuple[Array, Array],
    focal_px: tuple[float, float],
    baseline_m: float,
    sigma_m: float,
    *,
    settings: TieSettings,
) -> Array:
    """Covariance (6, 6) of rotation vector and translation in the previous camera's axes.

    Parameters
    ----------
    adjusted
        The step as adjusted to the rays (n, 2) of both images.
    rays
        Those rays.
    focal_px
        fx, fy.
    baseline_m, sigma_m
        Length of the step and its standard deviation.
    settings
        Errors of ties, and the scale of their cost.
    """
    focal = 0.5 * (focal_px[0] + focal_px[1])
    distances, jacobian = motion_jacobian(*rays, adjusted.rotation, adjusted.direction, focal)
    weight = 1 / (settings.sigma_px**2 * (1 + (distances / settings.fine_last_scale_px) ** 2))
    shared = correlated_motion_covariance(
        rays[1],
        adjusted.rotation.T @ adjusted.direction,
        adjusted.covariance @ (jacobian * weight[:, None]).T,
        focal_px=focal,
        sigma_px=correlated_sigma_px(parallax_px(adjusted, focal), settings),
        reach_px=settings.correlation_reach_px,
    )
    basis = tangent_basis(adjusted.direction)
    spread = np.zeros((6, 5))
    spread[:3, :3] = np.eye(3)
    spread[3:, 3:] = baseline_m * basis.T
    covariance = spread @ (adjusted.covariance + shared) @ spread.T
    covariance[3:, 3:] += sigma_m**2 * np.outer(adjusted.direction, adjusted.direction)
    return np.asarray(covariance)
