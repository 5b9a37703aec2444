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
from wayside.stages.detection.detector import detect
from wayside.stages.detection.detector_outputs import recognised
from wayside.stages.detection.external_boxes import detect_externally
from wayside.stages.detection.network_proposals import (
    CENTRE_PX,
    IMAGE,
    MAPS,
    MULTIPLE,
    OUTPUT,
    SIDE_PX,
    STRIDE,
    DetectionNetwork,
    boxes_of_maps,
    padded,
)
from wayside.stages.detection.onnx_detector import (
    multiple_of,
    named_boxes,
)
from wayside.stages.detection.proposals import propose

__all__ = [
    "BOX_OUTPUT",
    "BOX_VALUES",
    "CENTRE_PX",
    "COLOR_AT",
    "IMAGE",
    "INNER",
    "MAPS",
    "MULTIPLE",
    "OFFSET_AT",
    "OUTPUT",
    "PATCHES",
    "SHAPE_AT",
    "SIDE",
    "SIDE_PX",
    "SIZES",
    "STRIDE",
    "BoxClassifier",
    "BoxNetwork",
    "DetectionNetwork",
    "boxes_of_maps",
    "detect",
    "detect_externally",
    "drawn_patches",
    "multiple_of",
    "named_boxes",
    "padded",
    "propose",
    "recognised",
]
