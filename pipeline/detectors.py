"""How the candidates of an image are found: by networks, by gates of the report, or by another detector."""

from dataclasses import dataclass, field
from typing import Any, TypeVar

from wayside.pipeline.models.model_files import Models
from wayside.pipeline.workers import Stage, stage
from wayside.schemas.detectors import DetectorFile
from wayside.schemas.settings import Settings
from wayside.stages.detection import (
    BoxClassifier,
    BoxNetwork,
    DetectionNetwork,
    OnnxDetector,
    detect,
    detect_externally,
    propose,
)
from wayside.stages.mapping import LandmarkClassifier, SideClassifiers
from wayside.stages.report import classify_color, classify_shape
from wayside.stages.segmentation import segment

Kind = TypeVar("Kind")


@dataclass(frozen=True, slots=True)
class Detector:
    """Finds the candidates of every image, and names the classifiers of the panels tracked from them."""

    stages: list[Stage[Any, Any]]
    """From images to detections."""
    front: SideClassifiers = field(default_factory=SideClassifiers)
    """Classifiers of panels seen from the front; none by default."""
    back: SideClassifiers | None = None
    """Classifiers of panels seen from behind. None: they are not tracked."""


def detector_of(settings: Settings, models: Models) -> Detector:
    """The detector that the settings and models ask for; its networks are shared by all workers."""
    if settings.report.on:
        return report_gates(settings, models)
    return (networks if models.external is None else given_boxes)(settings, models)


def networks(s: Settings, m: Models) -> Detector:
    """Boxes of the detection network, classified by the box network."""
    boxes = _box_network(m)
    front = _needed(m.front_scores, "front.json")
    network = DetectionNetwork(_needed(m.detection_network, "network.onnx").path)
    back = None
    if m.back_scores is not None:
        behind = BoxClassifier(boxes, m.back_scores, back=True)
        back = SideClassifiers(behind, LandmarkClassifier(m.back_landmark_classifier))
    classified = stage(
        "detect", detect, settings=s.candidates, network=boxes, front=front, back=m.back_scores
    )
    view = BoxClassifier(boxes, front, back=False)
    judges = SideClassifiers(view, LandmarkClassifier(m.landmark_classifier))
    return Detector([stage("propose", propose, network=network), classified], judges, back)


def report_gates(s: Settings, m: Models) -> Detector:
    """The report's own: segments that pass the gates of size, colour and, in its first chain, shape (chapter 4)."""
    stages: list[Stage[Any, Any]] = [
        stage("segment", segment, s.segment, s.gate),
        stage("color", classify_color, model=_needed(m.color_classes, "color_rgb.json")),
    ]
    if m.shape_classes is not None:
        stages.append(stage("shape", classify_shape, model=m.shape_classes))
    return Detector(stages)


def given_boxes(s: Settings, m: Models) -> Detector:
    """Another detector, or a file of boxes. The box network names the colours and shapes that it does not.

    Nothing judges its panels: the classifiers that ship were learned on the scores of wayside's own.
    """
    given = m.external
    source = OnnxDetector(given) if isinstance(given, DetectorFile) else _needed(given, "boxes")
    found = stage(
        "detect", detect_externally, source=source, settings=s.candidates, network=_box_network(m)
    )
    return Detector([found])


def _box_network(models: Models) -> BoxNetwork:
    return BoxNetwork(_needed(models.box_network, "box.onnx").path)


def _needed(model: Kind | None, name: str) -> Kind:
    """A model that `load_models` gives for this detector; raises ValueError where another gave none."""
    if model is None:
        raise ValueError(f"models: this detector needs {name}")
    return model
