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
from wayside.stages.odometry.motion_prior import FIX_SIGMA_M, predict_alone
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.relative_pose import (
    RelativePose,
    TiedPair,
    common_motion,
    fit_coarse_motion,
)
from wayside.stages.odometry.tie_points import KeypointImage, PairMotion, RegisteredTies
from wayside.stages.odometry.visual_odometry import (
    ImagePair,
    VisualOdometry,
    estimate_motion,
    pair_images,
    tie_images,
)

__all__ = [
    "AXES",
    "FIX_SIGMA_M",
    "Agreement",
    "CameraPath",
    "ImagePair",
    "ImageStep",
    "KeypointImage",
    "Mount",
    "PairMotion",
    "RegisteredTies",
    "RelativePose",
    "TiedPair",
    "VisualOdometry",
    "agreement",
    "common_motion",
    "estimate_motion",
    "extract_features",
    "fit_coarse_motion",
    "image_step",
    "pair_images",
    "predict_alone",
    "sampson_px",
    "tie_corners",
    "tie_images",
    "upright",
]
