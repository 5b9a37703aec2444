"""Regions of an image to detected sign faces: proposals, learned classifiers, box regression."""

from wayside.stages.detection.box_regression import FARTHEST, SIDES
from wayside.stages.detection.boxes import overlap_of, shared_of, suppressed_boxes
from wayside.stages.detection.detector import (
    OVERLAP,
    REACH,
    BoxClassifier,
    face_chances,
    gate_features,
    gate_names,
    judge,
    moved_regions,
    view_features,
    view_names,
    view_odds,
)
from wayside.stages.detection.patch_cnn import DARK, FEATURES, patch_odds, told_of
from wayside.stages.detection.patch_features import INNER, SIDE, drawn_patches
from wayside.stages.detection.proposals import MOST, SHORTEST_PX, propose
from wayside.stages.detection.region_features import REGION_FEATURES

__all__ = [
    "DARK",
    "FARTHEST",
    "FEATURES",
    "INNER",
    "MOST",
    "OVERLAP",
    "REACH",
    "REGION_FEATURES",
    "SHORTEST_PX",
    "SIDE",
    "SIDES",
    "BoxClassifier",
    "drawn_patches",
    "face_chances",
    "gate_features",
    "gate_names",
    "judge",
    "moved_regions",
    "overlap_of",
    "patch_odds",
    "propose",
    "shared_of",
    "suppressed_boxes",
    "told_of",
    "view_features",
    "view_names",
    "view_odds",
]
