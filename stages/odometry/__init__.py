"""Tie points of two images and the motion of the camera between them (report chapters 6 to 8)."""

from wayside.stages.odometry.drive_motion import estimate_motion
from wayside.stages.odometry.epipolar import sampson_px
from wayside.stages.odometry.features import extract_features, tie_corners
from wayside.stages.odometry.motion_prior import MotionPrior
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.relative_pose import (
    RelativePose,
    fit_coarse_motion,
    fit_relative_pose,
)
from wayside.stages.odometry.tie_points import KeypointImage, RegisteredTies
from wayside.stages.odometry.visual_odometry import VisualOdometry

__all__ = [
    "KeypointImage",
    "MotionPrior",
    "Mount",
    "RegisteredTies",
    "RelativePose",
    "VisualOdometry",
    "estimate_motion",
    "extract_features",
    "fit_coarse_motion",
    "fit_relative_pose",
    "sampson_px",
    "tie_corners",
]
