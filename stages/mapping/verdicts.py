"""Verdicts on landmarks, and on candidates that no landmark has.

While it is tracked (`tracker`): `moving` where the vehicle drove, or `duplicate` of a landmark of higher sum. Where the
sum of all terms of evidence is below the threshold, it is the verdict of the weakest term (`VERDICT_OF_TERM`).
Afterwards (`location_verdict`, `same_panel`): `location`, `panel_size`, `duplicate`. A landmark that passes all is a
`sign`. Verdicts of single candidates in one image are the detection's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import verdict_code
from wayside.schemas.landmarks import Landmark
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import LocateSettings
from wayside.stages.classifiers import class_distances
from wayside.stages.geometry import FrenetOffset, box_areas
from wayside.stages.mapping.landmark_fit import LandmarkFit

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
# Set on the development drives.
SUPPORT_M = 0.6
"""Panels of one support are nearer than this, with less between them, m."""
SAME_SHARE = 0.4
"""Centres nearer than this are one panel's, by its size."""
ALONG_SIGMAS, ALONG_M = 2.5, 2.0
"""Tolerance along the path, standard deviations, and its largest, m."""

_NOWHERE = np.zeros(4)


def in_swept_volume(fit: LandmarkFit, offset: FrenetOffset) -> bool:
    """Whether it lies where the vehicle drove: it then moves (at a constant pace)."""
    bottom = offset.above - fit.metric[1] / 2
    return bool(abs(offset.right) < SWEPT_HALF_WIDTH_M and bottom < SWEPT_HEIGHT_M)


class SeenBox(NamedTuple):
    """Where a landmark is in one image."""

    box: NDArray[np.float64]
    """As rays, (4,)."""
    seen: bool
    """Whether the image shows it there. Otherwise it only must be there."""
    measured: bool
    """Whether a candidate of the image gave the box, not a prediction."""


def same_face(one: Mapping[int, SeenBox], other: Mapping[int, SeenBox]) -> bool:
    """Whether two landmarks explain the same pixels, so that only one of them can be a face.

    Panels are opaque: the images that show two show them side by side, the near ones best. So of the pixels of the
    smaller box in each image that shows both, all these images together, not `MOST` lie in the other. Where no two
    images show both, all that show either are counted, with nothing shared where the other cannot be seen.

    Parameters
    ----------
    one, other
        Boxes by image number, of the same images; none of those in which a landmark cannot be seen.
    """
    images = [(one.get(k), other.get(k)) for k in sorted(one.keys() | other.keys())]
    either = [pair for pair in images if any(a is not None and a.measured for a in pair)]
    both = [pair for pair in either if all(a is not None and a.seen for a in pair)]
    pairs = both if len(both) > 1 else either
    if len(pairs) < 2:
        return False
    boxes = np.array([[_NOWHERE if a is None else a.box for a in pair] for pair in pairs])
    areas = box_areas(boxes)
    smaller = np.where(areas.min(axis=1) > 0, areas.min(axis=1), areas.max(axis=1))
    low, high = boxes[..., :2].max(axis=1), boxes[..., 2:].min(axis=1)
    shared = box_areas(np.concatenate([low, high], axis=1))
    return bool(shared.sum() > MOST * smaller.sum())


def location_verdict(
    landmark: Landmark, model: GaussianModel | None, settings: LocateSettings
) -> str:
    """`location` beyond all thresholds of the model (None: anywhere), `panel_size`, or `sign`."""
    if model is not None:
        thresholds = np.array([c.threshold for c in model.classes])
        where = np.array([[landmark.right_m, landmark.above_m]])
        if (class_distances(where, model)[0] > thresholds).all():
            return "location"
    sides = (landmark.width_m, landmark.height_m)
    if min(sides) < settings.smallest_side_m or max(sides) > settings.largest_side_m:
        return "panel_size"
    return "sign"


def same_panel(one: Landmark, other: Landmark) -> bool:
    """Whether two landmarks are one panel: centres close in its plane, and along the path within their scatter."""
    wide, tall = (one.width_m + other.width_m) / 2, (one.height_m + other.height_m) / 2
    return bool(
        abs(one.right_m - other.right_m) < SAME_SHARE * wide
        and abs(one.above_m - other.above_m) < SAME_SHARE * tall
        and same_station(one, other)
    )


def same_station(one: Landmark, other: Landmark) -> bool:
    """Whether two landmarks may stand at one station, by the scatter of both along the path."""
    variance = one.covariance[2, 2] + other.covariance[2, 2]
    scatter = min(ALONG_M, ALONG_SIGMAS * float(np.sqrt(variance)))
    return abs(one.station_m - other.station_m) < max(SUPPORT_M, scatter)


def unassigned_verdicts(
    paired: NDArray[np.bool_], standing: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Verdicts (k,) of candidates that no landmark has, paired (k, 2) with an earlier and with a later candidate.

    `far_view` where it was standing (k,): a view of a landmark that was in sight still when the image left the window.
    Else `unmatched` with neither, `few_views` with one of both; with both it fits no standing point: `moving`.
    """
    codes = [verdict_code(v) for v in ("unmatched", "few_views", "moving")]
    by_pairs = np.take(codes, paired.sum(axis=1))
    return np.asarray(np.where(standing, verdict_code("far_view"), by_pairs), np.uint8)
