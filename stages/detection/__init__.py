"""Regions of an image to detected sign faces: proposals, learned classifiers, box regression."""

from wayside.stages.detection.box_classifier import BoxClassifier
from wayside.stages.detection.box_network import (
    BOX_OUTPUT,
    BOX_VALUES,
    COLOR_AT,
    OFFSET_AT,
    PATCHES,
    SHAPE_AT,
    SIZES,
    BoxNetwork,
)
from wayside.stages.detection.box_patches import INNER, SIDE, drawn_patches
from wayside.stages.detection.detector import SAME_FACE_IOU, detect
from wayside.stages.detection.detector_outputs import recognised
from wayside.stages.detection.external_boxes import detect_externally
from wayside.stages.detection.network_proposals import (
    BIAS,
    CENTRE_PX,
    FEATURES,
    HEAT,
    IMAGE,
    MAPS,
    MULTIPLE,
    ODDS,
    OUTPUT,
    SCALE,
    SIDE_PX,
    STRIDE,
    WEIGHT,
    DetectionNetwork,
    Maps,
    boxes_of_maps,
    padded,
)
from wayside.stages.detection.onnx_detector import (
    OnnxDetector,
    multiple_of,
    named_boxes,
)
from wayside.stages.detection.proposals import propose, propose_segments

__all__ = [
    "BIAS",
    "BOX_OUTPUT",
    "BOX_VALUES",
    "CENTRE_PX",
    "COLOR_AT",
    "FEATURES",
    "HEAT",
    "IMAGE",
    "INNER",
    "MAPS",
    "MULTIPLE",
    "ODDS",
    "OFFSET_AT",
    "OUTPUT",
    "PATCHES",
    "SAME_FACE_IOU",
    "SCALE",
    "SHAPE_AT",
    "SIDE",
    "SIDE_PX",
    "SIZES",
    "STRIDE",
    "WEIGHT",
    "BoxClassifier",
    "BoxNetwork",
    "DetectionNetwork",
    "Maps",
    "OnnxDetector",
    "boxes_of_maps",
    "detect",
    "detect_externally",
    "drawn_patches",
    "multiple_of",
    "named_boxes",
    "padded",
    "propose",
    "propose_segments",
    "recognised",
]
