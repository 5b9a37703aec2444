"""What finds the candidates of an image, and what is known of panels that are made of them: one protocol, three kinds.

A detector of your own needs `stages` that turn images into detections, and the classifiers of what is tracked from
them, or none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from wayside.pipeline.models.model_files import Models
from wayside.pipeline.workers import Stage, stage
from wayside.schemas.detectors import BoxFile, DetectorFile
from wayside.schemas.models import ScoreModel
from wayside.schemas.settings import Settings
from wayside.stages.detection import (
    BoxClassifier,
    BoxNetwork,
    DetectionNetwork,
    OnnxDetector,
    detect,
    detect_externally,
    propose,
    propose_segments,
)
from wayside.stages.mapping import LandmarkClassifier, SideClassifiers
from wayside.stages.report import classify_color, classify_shape
from wayside.stages.segmentation import segment

Kind = TypeVar("Kind")


class Detector(Protocol):
    """Finds the candidates of every image."""

    def stages(self) -> list[Stage[Any, Any]]:
        """From images to detections."""

    def front(self) -> SideClassifiers:
        """What judges panels seen from the front."""

    def back(self) -> SideClassifiers | None:
        """What judges panels seen from behind; None: they are not tracked."""


def detector_of(settings: Settings, models: Models) -> Detector:
    """The detector that the settings and models are of."""
    if settings.report.on:
        return ReportGates(settings, models)
    return (
        Networks.of(settings, models)
        if models.external is None
        else GivenBoxes.of(settings, models)
    )


@dataclass(frozen=True, slots=True)
class Networks:
    """wayside's own: boxes of the detection network, each classified by the box network.

    Without a detection network every segment is classified.
    """

    settings: Settings
    models: Models
    boxes: BoxNetwork
    proposer: DetectionNetwork | None

    @classmethod
    def of(cls, settings: Settings, models: Models) -> Networks:
        """Load the networks, which all workers share."""
        network = models.detection_network
        return cls(
            settings,
            models,
            _box_network(models),
            None if network is None else DetectionNetwork(network.path),
        )

    def stages(self) -> list[Stage[Any, Any]]:
        """Propose boxes, and classify them."""
        s, m = self.settings, self.models
        return [
            *self._proposals(),
            stage(
                "detect",
                detect,
                settings=s.candidates,
                network=self.boxes,
                front=_needed(m.front_scores, "front.json"),
                back=m.back_scores,
            ),
        ]

    def _proposals(self) -> list[Stage[Any, Any]]:
        s = self.settings
        if self.proposer is None:
            return [
                stage("segment", segment, s.segment, s.gate),
                stage("propose", propose_segments),
            ]
        return [stage("propose", propose, network=self.proposer)]

    def front(self) -> SideClassifiers:
        """Of views and of landmarks."""
        m = self.models
        landmark = LandmarkClassifier(m.landmark_classifier)
        return SideClassifiers(self._view(m.front_scores, back=False), landmark)

    def back(self) -> SideClassifiers | None:
        """The same of backs, where there are thresholds for them."""
        m = self.models
        view = self._view(m.back_scores, back=True)
        landmark = LandmarkClassifier(m.back_landmark_classifier)
        return None if view is None else SideClassifiers(view, landmark)

    def _view(self, scores: ScoreModel | None, *, back: bool) -> BoxClassifier | None:
        """Classifier of views of one side, where there is a threshold for it."""
        if scores is None:
            return None
        return BoxClassifier(self.boxes, scores, back=back)


@dataclass(frozen=True, slots=True)
class ReportGates:
    """The report's own: all segments that pass the gates of size, colour and, in its first chain, shape."""

    settings: Settings
    models: Models

    def stages(self) -> list[Stage[Any, Any]]:
        """Chapters 2 and 3.1, 3.2, and 4."""
        s, shapes = self.settings, self.models.shape_classes
        colors = _needed(self.models.color_classes, "color_rgb.json")
        return [
            stage("segment", segment, s.segment, s.gate),
            stage("color", classify_color, model=colors),
            *([] if shapes is None else [stage("shape", classify_shape, model=shapes)]),
        ]

    def front(self) -> SideClassifiers:
        """None: the gates of the chain judge."""
        return SideClassifiers()

    def back(self) -> SideClassifiers | None:
        """Backs are not tracked."""
        return None


@dataclass(frozen=True, slots=True)
class GivenBoxes:
    """Another detector, or a file of boxes. The box network names the colours and shapes that it does not."""

    settings: Settings
    source: OnnxDetector | BoxFile
    boxes: BoxNetwork

    @classmethod
    def of(cls, settings: Settings, models: Models) -> GivenBoxes:
        """Load it."""
        given = models.external
        if given is None:
            raise ValueError("models: neither a detector nor a file of boxes")
        source = OnnxDetector(given) if isinstance(given, DetectorFile) else given
        return cls(settings, source, _box_network(models))

    def stages(self) -> list[Stage[Any, Any]]:
        """Its boxes are the detections."""
        s = self.settings
        return [
            stage(
                "detect",
                detect_externally,
                source=self.source,
                settings=s.candidates,
                network=self.boxes,
            )
        ]

    def front(self) -> SideClassifiers:
        """None: the classifiers that ship were learned on the scores of wayside's own."""
        return SideClassifiers()

    def back(self) -> SideClassifiers | None:
        """Backs are not tracked."""
        return None


def _box_network(models: Models) -> BoxNetwork:
    return BoxNetwork(_needed(models.box_network, "box.onnx").path)


def _needed(model: Kind | None, name: str) -> Kind:
    """A model that `load_models` gives for this detector; raises ValueError where another gave none."""
    if model is None:
        raise ValueError(f"models: this detector needs {name}")
    return model
