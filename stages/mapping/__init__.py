"""Detections of several frames to landmarks in three dimensions (report chapters 5, 7, 8 and 11)."""

from wayside.stages.mapping.assembly import assemble
from wayside.stages.mapping.association import Gates
from wayside.stages.mapping.classifiers import SideClassifiers, ViewClassifier
from wayside.stages.mapping.covariance import STEP_SIGMA
from wayside.stages.mapping.hypotheses import Fit, fit_views
from wayside.stages.mapping.landmark import DOUBT, FEATURES, build_place, measured_place
from wayside.stages.mapping.location import classify_location
from wayside.stages.mapping.residual_scale import Scatter
from wayside.stages.mapping.tracker import track
from wayside.stages.mapping.window import Held, TravelledPath, sightings_of, through_window

__all__ = [
    "DOUBT",
    "FEATURES",
    "STEP_SIGMA",
    "Fit",
    "Gates",
    "Held",
    "Scatter",
    "SideClassifiers",
    "TravelledPath",
    "ViewClassifier",
    "assemble",
    "build_place",
    "classify_location",
    "fit_views",
    "measured_place",
    "sightings_of",
    "through_window",
    "track",
]
