"""Tie points of two images and the motion of the camera between them (report chapters 6 to 8)."""

from wayside.stages.odometry.epipolar import sampson_px as sampson_px
from wayside.stages.odometry.features import extract_features as extract_features
from wayside.stages.odometry.features import tie_corners as tie_corners
from wayside.stages.odometry.motion_agreement import AXES as AXES
from wayside.stages.odometry.motion_agreement import Agreement as Agreement
from wayside.stages.odometry.motion_agreement import CameraPath as CameraPath
from wayside.stages.odometry.motion_agreement import ImageStep as ImageStep
from wayside.stages.odometry.motion_agreement import agreement as agreement
from wayside.stages.odometry.motion_agreement import image_step as image_step
from wayside.stages.odometry.motion_agreement import upright as upright
from wayside.stages.odometry.motion_prior import FIX_SIGMA_M as FIX_SIGMA_M
from wayside.stages.odometry.motion_prior import MotionPrior as MotionPrior
from wayside.stages.odometry.mount import Mount as Mount
from wayside.stages.odometry.relative_pose import RelativePose as RelativePose
from wayside.stages.odometry.relative_pose import fit_coarse_motion as fit_coarse_motion
from wayside.stages.odometry.relative_pose import fit_relative_pose as fit_relative_pose
from wayside.stages.odometry.tie_points import KeypointImage as KeypointImage
from wayside.stages.odometry.tie_points import PairMotion as PairMotion
from wayside.stages.odometry.tie_points import RegisteredTies as RegisteredTies
from wayside.stages.odometry.visual_odometry import VisualOdometry as VisualOdometry
from wayside.stages.odometry.visual_odometry import estimate_motion as estimate_motion
from wayside.stages.odometry.visual_odometry import root_mean as root_mean
