"""Classifiers of panels of one side, handed to the tracker, which does not import the detection."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Regions
from wayside.schemas.frame import Camera
from wayside.stages.mapping.landmark_evidence import LandmarkClassifier


class ViewClassifier(Protocol):
    """Scores boxes of one image that tracking predicts."""

    @property
    def threshold(self) -> float:
        """Log odds from which a box counts as a view."""

    def scores(
        self, levels: tuple[NDArray[np.uint8], ...], regions: Regions, camera: Camera
    ) -> NDArray[np.float32]:
        """Log odds (n,) that the regions show panels; levels: the image at full, half and quarter size."""


@dataclass(frozen=True, slots=True)
class SideClassifiers:
    """Classifiers of panels seen from one side: of a `view` in one image (None: none is predicted), of a `landmark`."""

    view: ViewClassifier | None = None
    landmark: LandmarkClassifier = field(default_factory=LandmarkClassifier)
