"""Every verdict on a landmark, in the order of the rules, and on candidates that no landmark has.

While it is tracked (`position_verdict`, then `stands_still` once its panel is measured): `moving`, `place_score`,
`duplicate`, `residual`. Afterwards (`location_verdict`, `same_panel`): `location`, `panel_size`, `duplicate`. The first
rule that applies decides; a landmark that passes them all is a `sign`. Verdicts of single candidates in one image are
the detection's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import verdict_code
from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import AssemblySettings, LocateSettings, VerdictSettings
from wayside.stages.geometry import FrenetOffset, box_areas, intersection_areas
from wayside.stages.mapping.landmark_fit import LandmarkFit

LEAST_DEPTH_M = 0.5
"""Nearer to the camera a landmark has no box: division by its depth."""


def position_verdict(
    fit: LandmarkFit,
    offset: FrenetOffset,
    reported: Iterable[LandmarkFit],
    camera: Pose,
    settings: VerdictSettings,
    *,
    passes: bool,
) -> str:
    """`moving`, `place_score`, `duplicate`, or `sign` as far as position and classifier tell.

    Parameters
    ----------
    fit, offset
        The landmark, and where it stands beside the path.
    reported
        Signs of this window so far.
    camera
        The frame that shows it last.
    settings
        Limits of the rules.
    passes
        Whether the landmark classifier accepts it.
    """
    if in_swept_volume(fit, offset, settings):
        return "moving"
    if not passes:
        return "place_score"
    if any(same_face(fit, other, camera, settings) for other in reported):
        return "duplicate"
    return "sign"


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
    axis = camera.rotation[:, 2]
    near, far = sorted(float((f.point - camera.centre) @ axis) for f in (one, other))
    tolerance = max(
        settings.same_depth_share * near,
        settings.same_depth_m,
        settings.same_depth_sigmas * float(np.sqrt(axis @ one.covariance @ axis)),
    )
    if near <= 0 or far - near > tolerance:
        return False
    return max(mutual_cover(one, other, camera)) > settings.same_cover


def mutual_cover(one: LandmarkFit, other: LandmarkFit, camera: Pose) -> tuple[float, float]:
    """Share of each landmark's box that the other's covers in an image, (of one, of other)."""
    local = camera.to_camera(np.array([one.point, other.point]))
    depth = local[:, 2:]
    if depth.min() < LEAST_DEPTH_M:
        return 0.0, 0.0
    centre, half = local[:, :2] / depth, np.array([one.metric, other.metric]) / depth / 2
    box = np.concatenate([centre - half, centre + half], axis=1)
    of_one, of_other = intersection_areas(box[:1], box[1:])[0, 0] / box_areas(box)
    return float(of_one), float(of_other)


def stands_still(
    fit: LandmarkFit,
    registered: int,
    panel_px: float,
    log_odds: float,
    fewest: int,
    settings: VerdictSettings,
) -> bool:
    """Whether the views of a landmark are of one panel that stands still; else the verdict is `residual`.

    Any two rays meet somewhere: it takes a third box, or a panel that the registered images show. Two images of a
    vehicle may be registered as well, so there the landmark must be `sure_log_odds` a panel. And of few boxes, which
    may be of several panels in line, two images must register, if it is not `certain_log_odds` a panel.

    Parameters
    ----------
    fit
        The landmark.
    registered
        Images of it that register with each other.
    panel_px
        RMS residual of its panel in these, inf where there is no panel.
    log_odds
        Log odds that it is a panel.
    fewest
        Views that a sign needs.
    settings
        Limits of the rules.
    """
    boxes = max(fewest, settings.fewest_boxes)
    if log_odds >= settings.certain_log_odds and len(fit.rows) >= boxes:
        return True
    if fit.used.sum() >= boxes:
        return len(fit.rows) >= settings.sufficient_boxes or registered >= 2
    if registered < fewest:
        return False
    if registered >= settings.fewest_boxes:
        return panel_px < settings.register_px
    return log_odds >= settings.sure_log_odds and panel_px < settings.register_pair_px


def location_verdict(landmark: Landmark, model: GaussianModel, settings: LocateSettings) -> str:
    """`location` beyond all thresholds of the model for so unsure a sign, `panel_size`, or `sign`.

    The model knows nothing of backs, which are those of the other carriageway: they may stand anywhere.
    """
    thresholds = np.array([c.threshold for c in model.classes])
    where = np.array([[landmark.right_m, landmark.above_m]])
    beyond = float((model.distances(where)[0] - thresholds).min())
    if not landmark.back and beyond > 0 and not landmark.score > settings.beyond * beyond:
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


def unassigned_verdicts(paired: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Verdicts (k,) of candidates that no landmark has, paired (k, 2) with an earlier and with a later candidate.

    `unmatched` with neither, `few_views` with one of both; with both it fits no standing point: `moving`.
    """
    codes = [verdict_code(v) for v in ("unmatched", "few_views", "moving")]
    return np.asarray(np.take(codes, paired.sum(axis=1)), np.uint8)


class VerdictRevision:
    """Verdicts of later stages, by track: its candidates follow, in this frame and those still to come."""

    def __init__(self) -> None:
        self._changed: dict[int, tuple[str, int]] = {}

    def apply(self, frame: TrackedFrame, landmarks: Sequence[Landmark]) -> TrackedFrame:
        """The frame with those landmarks instead of its own, its candidates after them."""
        for landmark in landmarks:
            if landmark.verdict != "sign":
                last = max(view.frame for view in landmark.views)
                self._changed[landmark.track_id] = (landmark.verdict, last)
        verdict = frame.candidates.verdict.copy()
        for track, (name, last) in list(self._changed.items()):
            own = (frame.track_id == track) & (verdict == verdict_code("sign"))
            verdict[own] = verdict_code(name)
            if last <= frame.frame.index:
                del self._changed[track]
        table = replace(frame.candidates, verdict=verdict)
        return replace(frame, candidates=table, landmarks=tuple(landmarks))
