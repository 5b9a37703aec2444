"""Regions of an image to detected sign faces: proposals, learned classifiers, box regression."""

from wayside.stages.detection.box_classifier import BoxClassifier
from wayside.stages.detection.box_regression import SIDES, regressed_regions
from wayside.stages.detection.detector import detect, name_log_probabilities, passes_network
from wayside.stages.detection.detector_outputs import recognised
from wayside.stages.detection.external_boxes import detect_externally
from wayside.stages.detection.feature_vectors import (
    REGION_FEATURES,
    box_feature_names,
    box_features,
)
from wayside.stages.detection.network_proposals import (
    CENTRE_PX,
    IMAGE,
    MAPS,
    SIDE_PX,
    STRIDE,
    DetectionNetwork,
    as_blob,
    boxes_of_maps,
)
from wayside.stages.detection.onnx_detector import (
    OnnxNetwork,
    multiple_of,
    named_boxes,
)
from wayside.stages.detection.patch_cnn import (
    PATCH_CNN_FEATURES,
    PATCH_DARK_LEVEL,
    patch_log_odds,
    placement_features,
)
from wayside.stages.detection.patch_features import INNER, SIDE, drawn_patches
from wayside.stages.detection.proposals import propose

__all__ = [
    "CENTRE_PX",
    "IMAGE",
    "INNER",
    "MAPS",
    "PATCH_CNN_FEATURES",
    "PATCH_DARK_LEVEL",
    "REGION_FEATURES",
    "SIDE",
    "SIDES",
    "SIDE_PX",
    "STRIDE",
    "BoxClassifier",
    "DetectionNetwork",
    "OnnxNetwork",
    "as_blob",
    "box_feature_names",
    "box_features",
    "boxes_of_maps",
    "detect",
    "detect_externally",
    "drawn_patches",
    "multiple_of",
    "name_log_probabilities",
    "named_boxes",
    "passes_network",
    "patch_log_odds",
    "placement_features",
    "propose",
    "recognised",
    "regressed_regions",
]
