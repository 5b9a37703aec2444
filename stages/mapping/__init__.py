"""Detections of several frames to landmarks in three dimensions (report chapters 5, 7, 8 and 11)."""

from wayside.stages.mapping.assembly import assemble as assemble
from wayside.stages.mapping.assembly import classify_location as classify_location
from wayside.stages.mapping.association import GAP_SHARE as GAP_SHARE
from wayside.stages.mapping.landmark import STEP_COVARIANCE as STEP_COVARIANCE
from wayside.stages.mapping.landmark import box_panel as box_panel
from wayside.stages.mapping.landmark import point_covariance as point_covariance
from wayside.stages.mapping.landmark_evidence import FEATURES as FEATURES
from wayside.stages.mapping.landmark_evidence import LandmarkClassifier as LandmarkClassifier
from wayside.stages.mapping.landmark_fit import BOX_SIGMA as BOX_SIGMA
from wayside.stages.mapping.landmark_fit import LandmarkFit as LandmarkFit
from wayside.stages.mapping.local_adjustment import LandmarkMeasurement as LandmarkMeasurement
from wayside.stages.mapping.panel import USUAL_CAMERA_M as USUAL_CAMERA_M
from wayside.stages.mapping.panel import PanelModels as PanelModels
from wayside.stages.mapping.tracker import WINDOW_STEP as WINDOW_STEP
from wayside.stages.mapping.tracker import SideClassifiers as SideClassifiers
from wayside.stages.mapping.tracker import WindowSolver as WindowSolver
from wayside.stages.mapping.tracker import track as track
from wayside.stages.mapping.verdicts import VERDICT_OF_TERM as VERDICT_OF_TERM
from wayside.stages.mapping.window import WindowFrame as WindowFrame
