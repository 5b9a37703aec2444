"""Detections of several frames to landmarks in three dimensions (report chapters 5, 7, 8 and 11)."""

from wayside.stages.mapping.assembly import assemble, classify_location
from wayside.stages.mapping.association import GAP_SHARE
from wayside.stages.mapping.landmark import (
    STEP_COVARIANCE,
    box_panel,
    build_landmark,
    point_covariance,
)
from wayside.stages.mapping.landmark_evidence import FEATURES, LandmarkClassifier
from wayside.stages.mapping.landmark_fit import BOX_SIGMA, LandmarkFit
from wayside.stages.mapping.local_adjustment import LandmarkMeasurement
from wayside.stages.mapping.panel import USUAL_CAMERA_M, PanelModels
from wayside.stages.mapping.tracker import WINDOW_STEP, SideClassifiers, WindowSolver, track
from wayside.stages.mapping.verdicts import VERDICT_OF_TERM
from wayside.stages.mapping.window import (
    Each,
    WindowFrame,
    through_window,
)

__all__ = [
    "BOX_SIGMA",
    "FEATURES",
    "GAP_SHARE",
    "STEP_COVARIANCE",
    "USUAL_CAMERA_M",
    "VERDICT_OF_TERM",
    "WINDOW_STEP",
    "Each",
    "LandmarkClassifier",
    "LandmarkFit",
    "LandmarkMeasurement",
    "PanelModels",
    "SideClassifiers",
    "WindowFrame",
    "WindowSolver",
    "assemble",
    "box_panel",
    "build_landmark",
    "classify_location",
    "point_covariance",
    "through_window",
    "track",
]
