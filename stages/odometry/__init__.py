"""Tie points of two images and the motion of the camera between them (report chapters 6 to 8)."""

from wayside.stages.odometry.coarse_pose import fit_coarse_motion
from wayside.stages.odometry.correlated_errors import motion_slopes, shared_by_picture
from wayside.stages.odometry.features import extract_features
from wayside.stages.odometry.motion_prior import (
    FIX_SIGMA_M,
    POSE_SIGMA_M,
    POSE_SIGMA_RAD,
    Expectation,
)
from wayside.stages.odometry.mount import Vehicle
from wayside.stages.odometry.pose_covariance import SHARED_REACH_PX, shared_sigma_px
from wayside.stages.odometry.relative_pose import Step, fit_ties
from wayside.stages.odometry.tie_points import REGISTERED_SIGMA_PX, Tied, View
from wayside.stages.odometry.visual_odometry import Drive, estimate_motion

__all__ = [
    "FIX_SIGMA_M",
    "POSE_SIGMA_M",
    "POSE_SIGMA_RAD",
    "REGISTERED_SIGMA_PX",
    "SHARED_REACH_PX",
    "Drive",
    "Expectation",
    "Step",
    "Tied",
    "Vehicle",
    "View",
    "estimate_motion",
    "extract_features",
    "fit_coarse_motion",
    "fit_ties",
    "motion_slopes",
    "shared_by_picture",
    "shared_sigma_px",
]
