"""Verdicts on landmarks while they are tracked: what moves, and which of several on the same pixels is a face.

`moving` where the vehicle drove, `duplicate` of a landmark of higher sum. Where the sum of all terms of evidence is
below the threshold, it is the verdict of the weakest term (`VERDICT_OF_TERM`). A landmark that passes all is a `sign`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES
from wayside.stages.geometry import FrenetOffset, box_areas
from wayside.stages.mapping.association import NEAREST_M
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowFrame, WindowPoses

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


class Face(NamedTuple):
    """A landmark as the pixels that it explains: point (3,), size (2,) in metres, and its v views.

    Of the views: `number` (v,) of the image, `box` (v, 4) as rays, `measured` (v,): not a predicted one.
    """

    point: NDArray[np.float64]
    metric: NDArray[np.float64]
    number: NDArray[np.int64]
    box: NDArray[np.float64]
    measured: NDArray[np.bool_]

    @classmethod
    def of(cls, fit: LandmarkFit, window: Sequence[WindowFrame]) -> "Face":
        """Of a landmark in its window."""
        seen, frames = fit.followed_in(window), [window[k] for k in fit.frames]
        tables = [held.candidates.regions.source for held in frames]
        sources = [table[own] for table, own in zip(tables, seen["candidate"], strict=True)]
        return cls(
            fit.point,
            fit.metric,
            np.array([held.frame.index for held in frames]),
            np.hstack([seen["ray"] - seen["size"] / 2, seen["ray"] + seen["size"] / 2]),
            np.array(sources) != SOURCES.index("predicted"),
        )

    def boxes(self, images: WindowPoses) -> "FaceBoxes":
        """Where it is in the images of a window: as seen, else where it must be."""
        found = FaceBoxes.none(len(images.number))
        local = ((self.point - images.centre)[:, None] @ images.rotation)[:, 0]
        ahead = local[:, 2] > NEAREST_M
        depth = local[ahead, 2:]
        centre, half = local[ahead, :2] / depth, self.metric / depth / 2
        found.box[ahead] = np.hstack([centre - half, centre + half])
        held, own = np.nonzero(images.number[:, None] == self.number)
        found.box[held], found.measured[held] = self.box[own], self.measured[own]
        found.seen[held] = True
        return found


class FaceBoxes(NamedTuple):
    """Where a landmark is in n images: box (n, 4) as rays, all 0 where it cannot be seen; seen, measured (n,).

    The same of k landmarks has one axis more in front.
    """

    box: NDArray[np.float64]
    seen: NDArray[np.bool_]
    measured: NDArray[np.bool_]

    @classmethod
    def none(cls, count: int) -> "FaceBoxes":
        """Nowhere."""
        return cls(np.zeros((count, 4)), np.zeros(count, np.bool_), np.zeros(count, np.bool_))

    def explained_by(self, others: "Sequence[FaceBoxes]") -> bool:
        """Whether one of some others explains the same pixels."""
        if not others:
            return False
        stacked = FaceBoxes._make(np.stack(column) for column in zip(*others, strict=True))
        return bool(same_face(self, stacked).any())


def same_face(one: FaceBoxes, other: FaceBoxes) -> NDArray[np.bool_]:
    """Whether a landmark explains the same pixels of the same images as another, or each of k others (k,).

    Only one of them can be a face then.

    Panels are opaque: the images that show two show them side by side, the near ones best. So of the pixels of the
    smaller box in each image that shows both, all these images together, not `MOST` lie in the other. Where no two
    images show both, all that show either are counted, with nothing shared where the other cannot be seen.
    """
    either = one.measured | other.measured
    both = either & one.seen & other.seen
    images = np.where(both.sum(axis=-1, keepdims=True) > 1, both, either)
    own, others = box_areas(one.box), box_areas(other.box)
    least, most = np.minimum(own, others), np.maximum(own, others)
    smaller = np.where(least > 0, least, most)
    low = np.maximum(one.box[..., :2], other.box[..., :2])
    high = np.minimum(one.box[..., 2:], other.box[..., 2:])
    shared = box_areas(np.concatenate([low, high], axis=-1))
    most_shared = (shared * images).sum(axis=-1) > MOST * (smaller * images).sum(axis=-1)
    return np.asarray(most_shared & (images.sum(axis=-1) > 1))
