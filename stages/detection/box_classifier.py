"""The box classifier: log odds that a box shows a panel from one side, and where they are enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera
from wayside.schemas.models import ScoreModel
from wayside.stages.detection.box_network import BoxNetwork
from wayside.stages.detection.face_boxes import fits_face
from wayside.stages.imaging import Pyramid


@dataclass(frozen=True, slots=True)
class BoxClassifier:
    """The box network as a classifier of panels from the front, or from behind (`back`)."""

    network: BoxNetwork
    model: ScoreModel
    back: bool = False

    @property
    def threshold(self) -> float:
        """Log odds from which a box is accepted."""
        return self.model.threshold

    def takes(self, box: NDArray[np.float64], camera: Camera) -> bool:
        """Whether a box (4,) in an image of a camera has a size that is searched for."""
        return bool(fits_face(box[None], camera)[0])

    def scores(self, levels: Pyramid, box: NDArray[np.float32]) -> NDArray[np.float32]:
        """Log odds (n,) that boxes (n, 4) show such a panel; levels: the image at full, half and quarter size."""
        found = self.network.scores(levels, box)
        return found.back if self.back else found.front
