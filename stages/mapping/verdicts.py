"""Verdicts on landmarks while they are tracked: what moves, and which of several on the same pixels is a face.

`moving` where the vehicle drove, `duplicate` of a landmark of higher sum. Where the sum of all terms of evidence is
below the threshold, it is the verdict of the weakest term (`VERDICT_OF_TERM`). A landmark that passes all is a `sign`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES
from wayside.stages.geometry import FrenetOffset, box_areas
from wayside.stages.mapping.association import NEAREST_M
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowFrame

VERDICT_OF_TERM = {
    "appearance": "place_score",
    "views": "few_views",
    "size": "panel_size",
    "place": "location",
    "rigidity": "residual",
    "surroundings": "attached",
}
"""Verdict on a landmark by the term of evidence that weighs most against it."""
MOST = 0.5
"""Share of the pixels of a landmark from which on another explains them: a pixel belongs to one face. On nine real and
six rendered drives it is below 0.41 or above 0.55, but for one pair of landmarks."""
SWEPT_HALF_WIDTH_M, SWEPT_HEIGHT_M = 1.3, 2.0
"""Half width of what the vehicle sweeps, and its height above the camera, m: size of a vehicle."""


def in_swept_volume(fit: LandmarkFit, offset: FrenetOffset) -> bool:
    """Whether it lies where the vehicle drove: it then moves (at a constant pace)."""
    bottom = offset.above - fit.metric[1] / 2
    return bool(abs(offset.right) < SWEPT_HALF_WIDTH_M and bottom < SWEPT_HEIGHT_M)


class SeenBox(NamedTuple):
    """The box of a landmark in an image that shows it, as rays (4,). measured: a candidate gave it, no prediction."""

    box: NDArray[np.float64]
    measured: bool


class Face(NamedTuple):
    """A landmark as the pixels that it explains: point (3,), size (2,) in metres, its views by image number."""

    point: NDArray[np.float64]
    metric: NDArray[np.float64]
    views: Mapping[int, SeenBox]

    @classmethod
    def of(cls, fit: LandmarkFit, window: Sequence[WindowFrame]) -> Face:
        """Of a landmark in its window."""
        views, predicted = {}, SOURCES.index("predicted")
        for held, row in fit.views_in(window):
            one = held.followed[row]
            box = np.concatenate([one["ray"] - one["size"] / 2, one["ray"] + one["size"] / 2])
            source = held.candidates.regions.source[one["candidate"]]
            views[held.frame.index] = SeenBox(box, bool(source != predicted))
        return cls(fit.point, fit.metric, views)

    def boxes(self, window: Sequence[WindowFrame]) -> FaceBoxes:
        """Where it is in the images of a window: as seen, else where it must be."""
        found = FaceBoxes.none(len(window))
        for k, held in enumerate(window):
            x, y, z = held.motion.pose.to_camera(self.point)
            view = self.views.get(held.frame.index)
            if view is not None:
                found.box[k], found.measured[k] = view
                found.seen[k] = True
            elif z > NEAREST_M:
                centre, half = np.array([x, y]) / z, self.metric / z / 2
                found.box[k] = np.concatenate([centre - half, centre + half])
        return found


class FaceBoxes(NamedTuple):
    """Where a landmark is in n images: box (n, 4) as rays, all 0 where it cannot be seen; seen, measured (n,)."""

    box: NDArray[np.float64]
    seen: NDArray[np.bool_]
    measured: NDArray[np.bool_]

    @classmethod
    def none(cls, count: int) -> FaceBoxes:
        """Nowhere."""
        return cls(np.zeros((count, 4)), np.zeros(count, np.bool_), np.zeros(count, np.bool_))


def same_face(one: FaceBoxes, other: FaceBoxes) -> bool:
    """Whether two landmarks explain the same pixels of the same images, so that only one of them can be a face.

    Panels are opaque: the images that show two show them side by side, the near ones best. So of the pixels of the
    smaller box in each image that shows both, all these images together, not `MOST` lie in the other. Where no two
    images show both, all that show either are counted, with nothing shared where the other cannot be seen.
    """
    either = one.measured | other.measured
    both = either & one.seen & other.seen
    images = both if both.sum() > 1 else either
    if images.sum() < 2:
        return False
    boxes = np.stack([one.box[images], other.box[images]], axis=1)
    areas = box_areas(boxes)
    smaller = np.where(areas.min(axis=1) > 0, areas.min(axis=1), areas.max(axis=1))
    low, high = boxes[..., :2].max(axis=1), boxes[..., 2:].min(axis=1)
    shared = box_areas(np.concatenate([low, high], axis=1))
    return bool(shared.sum() > MOST * smaller.sum())
