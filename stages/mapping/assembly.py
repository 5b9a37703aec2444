"""What is left to decide of landmarks: where signs stand, and which hang on one support.

After that every candidate has the verdict of its landmark.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from wayside.schemas.detections import verdict_code
from wayside.schemas.landmarks import Landmark, Observation, TrackedFrame
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import LocateSettings
from wayside.stages.classifiers import log_ratios

REMEMBER_M = 60.0
"""Stretch of path over which landmarks are compared, m: longer than the window."""
# Set on the development drives.
SUPPORT_M = 0.6
"""Panels of one support are nearer than this, with less between them, m."""
ALONG_SIGMAS, ALONG_M = 2.5, 2.0
"""Tolerance along the path, standard deviations, and its largest, m."""


def classify_location(
    tracked: Iterator[TrackedFrame], model: GaussianModel | None, settings: LocateSettings
) -> Iterator[TrackedFrame]:
    """Refuse landmarks where no sign stands (`location`) or of no sign's size (`panel_size`).

    The report's classifier is one mean at 3.1 m right of and .6 m above the camera's path. Its threshold is on the
    Mahalanobis distance (eq. 3.1). Here it is on the likelihood ratio of a class to the places of other landmarks.
    Where the evidence for landmarks contains their place, no model refuses them again.

    `model`: classes in (right of the path, above the camera's path), metres; None: only sizes are refused. Raises
    ValueError where it is of another space.
    """
    if model is not None and model.space != "right_up_m":
        raise ValueError(f"a location model of space {model.space} instead of right_up_m")

    def located(one: Landmark, ratio: float) -> Landmark:
        sides = (one.width_m, one.height_m)
        if one.verdict != "sign":
            return one
        if model is not None and ratio < model.threshold:
            return replace(one, verdict="location")
        if model is not None and model.background:  # else a density, which is no evidence
            one = replace(one, evidence=(*one.evidence, ("place", ratio)))
        plausible = settings.smallest_side_m <= min(sides) and max(sides) <= settings.largest_side_m
        return one if plausible else replace(one, verdict="panel_size")

    for frame in tracked:
        places = np.array([(one.right_m, one.above_m) for one in frame.landmarks]).reshape(-1, 2)
        ratios = places[:, 0] if model is None else log_ratios(places, model).max(axis=1)
        landmarks = map(located, frame.landmarks, ratios.tolist())
        yield replace(frame, landmarks=tuple(landmarks))


def assemble(tracked: Iterator[TrackedFrame]) -> Iterator[TrackedFrame]:
    """Number the supports from 0, and decide every candidate."""
    views: defaultdict[int, list[tuple[Landmark, Observation]]] = defaultdict(list)
    recent: list[Landmark] = []
    count = 0
    for frame in tracked:
        landmarks = []
        for one in frame.landmarks:
            if one.verdict == "sign":
                near = (p.assembly for p in recent if same_support(one, p))
                one = replace(one, assembly=next(near, count))
                count += one.assembly == count
                recent.append(one)
            landmarks.append(one)
            for view in one.views:
                views[view.frame].append((one, view))
        decided = candidates_decided(frame, views.pop(frame.frame.index, ()))
        yield replace(decided, landmarks=tuple(landmarks))
        if frame.motion is not None:
            passed_m = frame.motion.station_m - REMEMBER_M
            recent = [p for p in recent if p.station_m > passed_m]


def candidates_decided(
    frame: TrackedFrame, views: Sequence[tuple[Landmark, Observation]]
) -> TrackedFrame:
    """The frame with its candidates after the landmarks that they are views of: a sign's before any other's."""
    verdict = frame.candidates.verdict.copy()
    track_id, residual_px = frame.track_id.copy(), frame.residual_px.copy()
    for one, view in sorted(views, key=lambda v: (v[0].verdict == "sign", v[0].track_id)):
        verdict[view.row] = verdict_code(one.verdict)
        track_id[view.row], residual_px[view.row] = one.track_id, view.residual_px
    candidates = replace(frame.candidates, verdict=verdict)
    return replace(frame, candidates=candidates, track_id=track_id, residual_px=residual_px)


def same_support(one: Landmark, other: Landmark) -> bool:
    """Whether two panels hang on one support: one above the other or side by side, without much between."""
    right, above = abs(one.right_m - other.right_m), abs(one.above_m - other.above_m)
    between = max(
        right - (one.width_m + other.width_m) / 2, above - (one.height_m + other.height_m) / 2
    )
    variance = one.covariance[2, 2] + other.covariance[2, 2]
    along = max(SUPPORT_M, min(ALONG_M, ALONG_SIGMAS * float(np.sqrt(variance))))
    same_station = abs(one.station_m - other.station_m) < along
    return bool(min(right, above) < SUPPORT_M and between < SUPPORT_M and same_station)
