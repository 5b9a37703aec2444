"""Tie points of two images and the motion of the camera between them (report chapters 6 to 8)."""

from wayside.stages.odometry.coarse_pose import fit_coarse_motion
from wayside.stages.odometry.correlated_errors import correlated_point_covariance, motion_jacobian
from wayside.stages.odometry.features import extract_features
from wayside.stages.odometry.motion_prior import (
    FIX_SIGMA_M,
    POSE_SIGMA_M,
    POSE_SIGMA_RAD,
    MotionPrior,
)
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.pose_covariance import CORRELATION_REACH_PX, correlated_sigma_px
from wayside.stages.odometry.relative_pose import RelativePose, fit_relative_pose
from wayside.stages.odometry.tie_points import REGISTERED_SIGMA_PX, KeypointImage, RegisteredTies
from wayside.stages.odometry.visual_odometry import VisualOdometry, estimate_motion

__all__ = [
    "CORRELATION_REACH_PX",
    "FIX_SIGMA_M",
    "POSE_SIGMA_M",
    "POSE_SIGMA_RAD",
    "REGISTERED_SIGMA_PX",
    "KeypointImage",
    "MotionPrior",
    "Mount",
    "RegisteredTies",
    "RelativePose",
    "VisualOdometry",
    "correlated_point_covariance",
    "correlated_sigma_px",
    "estimate_motion",
    "extract_features",
    "fit_coarse_motion",
    "fit_relative_pose",
    "motion_jacobian",
]
