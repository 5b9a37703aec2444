"""Verdicts on landmarks while they are tracked: what moves, and which of several on the same pixels is a face.

`moving` where the vehicle drove, `duplicate` of a landmark of higher sum. Where the sum of all terms of evidence is
below the threshold, it is the verdict of the weakest term (`VERDICT_OF_TERM`). A landmark that passes all is a `sign`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Rows
from wayside.stages.geometry import FrenetOffset, box_areas
from wayside.stages.mapping.association import NEAREST_M
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowPoses, joined

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
six development drives it is below 0.41 or above 0.55, but for one pair of landmarks."""
SWEPT_HALF_WIDTH_M, SWEPT_HEIGHT_M = 1.3, 2.0
"""Half width of what the vehicle sweeps, and its height above the camera, m: size of a vehicle."""


def in_swept_volume(fit: LandmarkFit, offset: FrenetOffset) -> bool:
    """Whether it lies where the vehicle drove: it then moves (at a constant pace)."""
    bottom = offset.above - fit.metric[1] / 2
    return bool(abs(offset.right) < SWEPT_HALF_WIDTH_M and bottom < SWEPT_HEIGHT_M)


@dataclass(frozen=True, slots=True)
class FaceBoxes(Rows):
    """Where a landmark is in n images: box (n, 4) as rays, all 0 where it cannot be seen; seen, measured (n,).

    The same of k landmarks has one axis more in front.
    """

    box: NDArray[np.float64]
    seen: NDArray[np.bool_]
    measured: NDArray[np.bool_]

    @classmethod
    def none(cls, *shape: int) -> "FaceBoxes":
        """Nowhere, in so many images, or of so many landmarks in so many images."""
        return cls(np.zeros((*shape, 4)), np.zeros(shape, np.bool_), np.zeros(shape, np.bool_))

    @classmethod
    def of(cls, fits: Sequence[LandmarkFit], images: WindowPoses) -> "FaceBoxes":
        """Of k landmarks in the images of a window: as seen, else where they must be."""
        found = cls.none(len(fits), len(images.number))
        if not fits:
            return found
        point, metric = np.stack([f.point for f in fits]), np.stack([f.metric for f in fits])
        local = ((point[:, None] - images.centre)[:, :, None] @ images.rotation)[:, :, 0]
        depth = np.where(local[..., 2:] > NEAREST_M, local[..., 2:], np.inf)
        centre, half = local[..., :2] / depth, metric[:, None] / depth / 2
        found.box[:] = np.concatenate([centre - half, centre + half], axis=2)
        of = np.repeat(np.arange(len(fits)), [len(f.seen) for f in fits])
        seen = joined(f.seen for f in fits)
        at = np.searchsorted(images.number, seen["image"])
        held = np.flatnonzero(np.append(images.number, -1)[at] == seen["image"])
        of, at, seen = of[held], at[held], seen[held]
        middle, half = seen["ray"], seen["size"] / 2
        found.box[of, at] = np.concatenate([middle - half, middle + half], axis=1)
        found.seen[of, at], found.measured[of, at] = True, ~seen["predicted"]
        return found


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
