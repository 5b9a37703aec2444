"""Tie points of two images and the motion of the camera between them (report chapters 6 to 8)."""

from wayside.stages.odometry.epipolar import sampson_px
from wayside.stages.odometry.features import extract_features, tie_corners
from wayside.stages.odometry.motion_agreement import (
    AXES,
    Agreement,
    CameraPath,
    ImageStep,
    agreement,
    image_step,
    upright,
)
from wayside.stages.odometry.motion_prior import FIX_SIGMA_M, MotionPrior
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.relative_pose import RelativePose, fit_coarse_motion, fit_relative_pose
from wayside.stages.odometry.tie_points import KeypointImage, RegisteredTies
from wayside.stages.odometry.visual_odometry import VisualOdometry, estimate_motion, root_mean

__all__ = [
    "AXES",
    "FIX_SIGMA_M",
    "Agreement",
    "CameraPath",
    "ImageStep",
    "KeypointImage",
    "MotionPrior",
    "Mount",
    "RegisteredTies",
    "RelativePose",
    "VisualOdometry",
    "agreement",
    "estimate_motion",
    "extract_features",
    "fit_coarse_motion",
    "fit_relative_pose",
    "image_step",
    "root_mean",
    "sampson_px",
    "tie_corners",
    "upright",
]
