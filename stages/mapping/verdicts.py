"""Verdicts on landmarks, and on candidates that no landmark has.

While it is tracked (`tracker`): `moving` where the vehicle drove, the verdict of the weakest term of evidence
(`VERDICT_OF_TERM`) where the sum of all is below the threshold, `duplicate` of a landmark of higher sum. Afterwards
(`location_verdict`, `same_panel`): `location`, `panel_size`, `duplicate`. A landmark that passes all is a `sign`.
Verdicts of single candidates in one image are the detection's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import verdict_code
from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Landmark
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import AssemblySettings, LocateSettings, VerdictSettings
from wayside.stages.geometry import FrenetOffset, box_areas, intersection_areas, iou_matrix
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


def in_swept_volume(fit: LandmarkFit, offset: FrenetOffset, settings: VerdictSettings) -> bool:
    """Whether it stands where the vehicle drove: nothing stands there, so it moves (at a constant pace)."""
    bottom = offset.above - fit.metric[1] / 2
    return bool(
        abs(offset.right) < settings.swept_half_width_m and bottom < settings.swept_height_m
    )


def same_face(
    one: LandmarkFit, other: LandmarkFit, camera: Pose, settings: VerdictSettings
) -> bool:
    """Whether two landmarks are one face: at like depth, one before the other, seen from a camera.

    A depth of large scatter (a few far views) is like any depth within its error.
    """
    local, metric = camera.to_camera(np.array([one.point, other.point])), (one.metric, other.metric)
    axis, depth = camera.rotation[:, 2], local[:, 2:]
    near, far = float(depth.min()), float(depth.max())
    tolerance = max(
        settings.same_depth_share * near,
        settings.same_depth_m,
        settings.same_depth_sigmas * float(np.sqrt(axis @ one.covariance @ axis)),
    )
    if near < settings.nearest_m or far - near > tolerance:
        return False
    centre, half = local[:, :2] / depth, np.array(metric) / depth / 2
    box = np.concatenate([centre - half, centre + half], axis=1)
    shared = intersection_areas(box[:1], box[1:])[0, 0]
    return bool(shared > settings.same_cover * box_areas(box).min())


class SeenBox(NamedTuple):
    """A box (4,) of a landmark in one image, pixels; predicted: by its point, not a candidate of that image."""

    box: NDArray[np.floating[Any]]
    predicted: bool


def same_face_in_images(
    one: Mapping[int, SeenBox], other: Mapping[int, SeenBox], same_iou: float
) -> bool:
    """Whether two landmarks, their boxes by image number, are one face that an error of the motion has placed twice.

    So where no image has a candidate of each, and where the predicted box of one overlaps the candidate of the other
    (IoU above `same_iou`) in two images at least, and in most of the images that have one and the other.
    """
    common = [(one[k], other[k]) for k in one.keys() & other.keys()]
    if any(not a.predicted and not b.predicted for a, b in common):
        return False
    one_predicted = [(a.box[None], b.box[None]) for a, b in common if a.predicted != b.predicted]
    on_other = sum(bool(iou_matrix(a, b)[0, 0] > same_iou) for a, b in one_predicted)
    return on_other > 1 and 2 * on_other > len(one_predicted)


def location_verdict(
    landmark: Landmark, model: GaussianModel | None, settings: LocateSettings
) -> str:
    """`location` beyond all thresholds of the model (None: anywhere), `panel_size`, or `sign`."""
    if model is not None:
        thresholds = np.array([c.threshold for c in model.classes])
        where = np.array([[landmark.right_m, landmark.above_m]])
        if (model.distances(where)[0] > thresholds).all():
            return "location"
    sides = (landmark.width_m, landmark.height_m)
    if min(sides) < settings.smallest_side_m or max(sides) > settings.largest_side_m:
        return "panel_size"
    return "sign"


def same_panel(one: Landmark, other: Landmark, settings: AssemblySettings) -> bool:
    """Whether two landmarks are one panel: centres close in its plane, and along the path within their scatter."""
    wide, tall = (one.width_m + other.width_m) / 2, (one.height_m + other.height_m) / 2
    return bool(
        abs(one.right_m - other.right_m) < settings.same_share * wide
        and abs(one.above_m - other.above_m) < settings.same_share * tall
        and same_station(one, other, settings)
    )


def same_station(one: Landmark, other: Landmark, settings: AssemblySettings) -> bool:
    """Whether two landmarks may stand at one station, by the scatter of both along the path."""
    variance = one.covariance[2, 2] + other.covariance[2, 2]
    scatter = min(settings.along_most_m, settings.along_sigmas * float(np.sqrt(variance)))
    return abs(one.station_m - other.station_m) < max(settings.support_m, scatter)


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
