"""Tracking: hypotheses from pairs, association, greedy acceptance, predicted views, evidence, verdict, measurement.

A panel that stands still is one point that all its views agree on. Every pair of candidates up to a few frames apart
that may show one panel makes a hypothesis. Hypotheses are associated with candidates in all frames held and accepted
greedily, best first. A landmark is finished when the vehicle has passed it (report chapters 5, 7 and 8).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Features
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.measurement import Measurement
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import TrackSettings
from wayside.stages.detection import BoxClassifier
from wayside.stages.geometry import FrenetOffset
from wayside.stages.kernels import Array
from wayside.stages.mapping.association import NEAREST_M, Hypotheses, pair_hypotheses
from wayside.stages.mapping.landmark import build_landmark, measure_landmark
from wayside.stages.mapping.landmark_evidence import (
    LandmarkClassifier,
    LandmarkEvidence,
    SignPlaces,
)
from wayside.stages.mapping.landmark_fit import BOX_SIGMA, LandmarkFit, accept_greedily
from wayside.stages.mapping.panel import PanelMeasurement, measure_panel
from wayside.stages.mapping.prediction import add_predicted_views
from wayside.stages.mapping.surroundings import surroundings_correlation
from wayside.stages.mapping.verdicts import (
    VERDICT_OF_TERM,
    Face,
    in_swept_volume,
    same_face,
)
from wayside.stages.mapping.window import (
    TravelledPath,
    WindowFrame,
    candidates_of,
    through_window,
)
from wayside.stages.panel import PanelMethod

WINDOW_STEP = 4
"""Frames between two solutions of the window: bounds the time."""
PAIR_REACH = 3
"""Frames between the two candidates of a hypothesis at most: one or two views may be missing between."""


@dataclass(frozen=True, slots=True)
class SideClassifiers:
    """Classifiers of panels seen from one side."""

    view: BoxClassifier | None = None
    """Of a view in one image. None: none is predicted."""
    landmark: LandmarkClassifier = field(default_factory=LandmarkClassifier)
    """Of a landmark."""


def track(
    posed: Iterator[PosedDetections],
    settings: TrackSettings,
    front: SideClassifiers | None = None,
    back: SideClassifiers | None = None,
    panel: PanelMethod | None = None,
    jointly: bool = False,
    box_sigma: tuple[float, float] = BOX_SIGMA,
) -> Iterator[TrackedFrame]:
    """Decide every candidate: measure it as a landmark with its other views, or say why not.

    Frames come out in order, each once, at most `longest` + `WINDOW_STEP` used frames late. A landmark comes with the
    first frame that it was seen in.

    Parameters
    ----------
    posed
        Frames with their candidates and motion.
    settings
        How long signs are followed, and by how many views.
    front
        Classifiers of faces: of landmarks (None: each whose views agree is a sign), and of predicted views (None: there
        are none).
    back
        The same of panels seen from behind; None: they are not tracked.
    panel
        How panels are measured as planes; None: they are not, boxes alone give position and size.
    jointly
        Whether a landmark is adjusted together with the motion.
    box_sigma
        Scatter of the centres of boxes, as `BOX_SIGMA`.
    """
    sides = {False: front or SideClassifiers()} | ({} if back is None else {True: back})
    yield from through_window(posed, _Tracker(settings, sides, panel, jointly, box_sigma))


class _Classified(NamedTuple):
    """A fitted landmark with what decides on it; surroundings: correlation round it. None: not measured."""

    fit: LandmarkFit
    offset: FrenetOffset
    evidence: LandmarkEvidence
    surroundings: float | None
    accepted: bool


class _Tracker:
    """The window of frames, and the hypotheses of each."""

    def __init__(
        self,
        settings: TrackSettings,
        sides: dict[bool, SideClassifiers],
        panel: PanelMethod | None,
        jointly: bool,
        box_sigma: tuple[float, float],
    ) -> None:
        self._settings, self._sides = settings, sides
        self._panel, self._jointly, self._box_sigma = panel, jointly, box_sigma
        self._places = {back: SignPlaces() for back in sides}
        self._length = settings.longest + WINDOW_STEP
        self._path = TravelledPath(self._length + settings.longest)
        self._window: list[WindowFrame] = []
        self._hypotheses: list[Hypotheses] = []
        self._reported: list[Face] = []
        self._next_id = 0

    def holds(self, frame: WindowFrame) -> bool:
        """Whether the frame is still in the window."""
        return any(f is frame for f in self._window)

    def append(self, frame: WindowFrame, features: Features) -> None:
        """Take the next frame; a full window is solved, and its oldest frames leave."""
        self._window.append(frame)
        self._path.append(frame.motion)
        self._hypotheses.append(self._pairs_of_newest())
        if len(self._window) >= self._length:
            self._solve(last=False)
            del self._window[:WINDOW_STEP], self._hypotheses[:WINDOW_STEP]

    def finish(self) -> None:
        """Solve what is left: no frame follows."""
        if self._window:
            self._solve(last=True)
        self._window.clear()
        self._hypotheses.clear()

    def _pairs_of_newest(self) -> Hypotheses:
        """Hypotheses from the newest frame with each of the few before it."""
        recent = self._window[-1 - PAIR_REACH :]
        newest = len(recent) - 1
        candidates = candidates_of(recent)
        first, found = candidates.first, []
        for older in range(newest):
            pairs, hypotheses = pair_hypotheses(candidates, older, newest, self._settings.gap_px)
            recent[older].followed["paired"][pairs[:, 0] - first[older], 1] = True
            recent[newest].followed["paired"][pairs[:, 1] - first[newest], 0] = True
            found.append(hypotheses)
        return Hypotheses.joined(found)

    def _solve(self, *, last: bool) -> None:
        """Decide the landmarks of the window that the vehicle has passed, most likely signs first.

        One waits where another that may be a sign, on the same pixels, is still in sight.
        """
        fits = self._fits()
        over = [last or self._passed(fit) for fit in fits]
        passed = self._predicted([fit for fit, done in zip(fits, over, strict=True) if done])
        ahead = [fit for fit, done in zip(fits, over, strict=True) if not done]
        oldest = self._window[0].motion.pose
        self._reported = [one for one in self._reported if not oldest.to_camera(one.point)[2] < 0]
        rivals = [Face.of(fit, self._window) for fit in ahead if self._classify(fit, nan).accepted]
        for one in sorted(map(self._classify, passed), key=lambda one: -one.evidence.log_odds):
            if one.accepted and self._is_explained(one.fit, rivals):
                ahead.append(one.fit)
            else:  # once more: the surer ones say where signs stand
                self._decide(self._classify(one.fit, one.surroundings))
        for fit in ahead:
            # views that leave the window though their landmark is still in sight
            for k, row in zip(fit.frames, fit.rows, strict=True):
                if k < WINDOW_STEP:
                    self._window[k].followed["standing"][row] = True

    def _fits(self) -> list[LandmarkFit]:
        """Landmarks of the unassigned candidates, faces before backs."""
        hypotheses, candidates = Hypotheses.joined(self._hypotheses), candidates_of(self._window)
        free = ~np.concatenate([f.followed["assigned"] for f in self._window])
        return [
            fit
            for back in self._sides
            for fit in accept_greedily(
                candidates,
                hypotheses.select(hypotheses.back == back),
                free & (candidates.back == back),
                self._settings,
                self._box_sigma,
            )
        ]

    def _predicted(self, fits: list[LandmarkFit]) -> list[LandmarkFit]:
        """The landmarks with the views that are seen where no candidate was found."""
        views = {back: side.view for back, side in self._sides.items() if side.view is not None}
        return add_predicted_views(fits, self._window, views)

    def _passed(self, fit: LandmarkFit) -> bool:
        """Whether a landmark lies outside the newest image, or too near to be seen in the next."""
        newest = self._window[-1]
        x, y, z = newest.motion.pose.to_camera(fit.point)
        if z < NEAREST_M:
            return True
        left, top, right, bottom = newest.bounds
        return not (left < x / z < right and top < y / z < bottom)

    def _classify(self, fit: LandmarkFit, surroundings: float | None = None) -> _Classified:
        """All evidence for a landmark; the surroundings of what cannot be a sign without them are not measured."""
        offset, places = self._path.offset(fit.point), self._places[fit.back]
        classifier = self._sides[fit.back].landmark
        known = nan if surroundings is None else surroundings
        evidence = classifier.classify(fit, self._window, offset, places, known)
        accepted = classifier.accepts(evidence)
        if surroundings is None and accepted:
            return self._classify(fit, surroundings_correlation(self._views_of(fit)))
        return _Classified(fit, offset, evidence, surroundings, accepted)

    def _decide(self, one: _Classified) -> None:
        """Give a landmark its verdict, measure it and hand it to its first frame."""
        fit, evidence = one.fit, one.evidence
        verdict, seen = self._verdict(one)
        jointly = self._jointly and verdict == "sign"
        measured = measure_landmark(fit, self._window, seen.panel, jointly)
        landmark = replace(
            build_landmark(
                fit,
                self._window,
                measured,
                self._path.offset(measured.point),
                track_id=self._next_id,
                score=evidence.score,
                verdict=verdict,
            ),
            features=tuple(evidence.features.tolist()),
            evidence=evidence.ratios,
        )
        if verdict == "sign":
            # Its panel as it was measured: boxes around a sign and its plaque would make the plaque a duplicate.
            size = np.array([landmark.width_m, landmark.height_m])
            face = Face.of(fit, self._window)._replace(point=measured.point, metric=size)
            self._reported.append(face)
            self._places[fit.back].add(one.offset, evidence.best_score)
        first = self._window[fit.frames[0]]
        first.landmarks.append(landmark)
        if seen.views or measured.residual is not None:
            shape = None if seen.outline is None else seen.outline.shape
            first.measurements.append(
                Measurement(
                    self._next_id, seen.views, seen.segments, shape, seen.face, measured.residual
                )
            )
        for held, row in fit.views_in(self._window):
            held.followed["assigned"][row] = True
        self._next_id += 1

    def _verdict(self, one: _Classified) -> tuple[str, PanelMeasurement]:
        """The verdict, and the panel, which is measured of what may be a sign."""
        fit, seen = one.fit, PanelMeasurement()
        if in_swept_volume(fit, one.offset):
            return "moving", seen
        if not one.accepted:
            return VERDICT_OF_TERM[one.evidence.weakest], seen
        if self._is_explained(fit, self._reported):
            return "duplicate", seen
        if self._panel is not None:
            seen = measure_panel(fit, self._window, one.offset, self._panel)
        # any two rays meet somewhere: where nothing is known of signs, images in register confirm it
        known = self._sides[fit.back].landmark.model is not None
        confirmed = known or fit.used.sum() > 2 or len(seen.views) > 1
        return "sign" if confirmed else "residual", seen

    def _is_explained(self, fit: LandmarkFit, others: list[Face]) -> bool:
        """Whether one of some others explains the same pixels."""
        boxes = Face.of(fit, self._window).boxes(self._window)
        return any(same_face(boxes, other.boxes(self._window)) for other in others)

    def _views_of(self, fit: LandmarkFit) -> Iterator[tuple[NDArray[np.uint8], Array]]:
        """The images that show a landmark, each with its box."""
        for held, row in fit.views_in(self._window):
            if held.rgb is not None:
                yield held.rgb, held.box(row)
