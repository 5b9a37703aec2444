"""Tracking: hypotheses from pairs, association, greedy acceptance, predicted views, evidence, verdict, measurement.

A panel that stands still is one point that all its views agree on. Every pair of candidates up to a few frames apart
that may show one panel makes a hypothesis. Hypotheses are associated with candidates in all frames held and accepted
greedily, best first. A landmark is finished when the vehicle has passed it (report chapters 5, 7 and 8).
"""

from abc import ABC, abstractmethod
from array import array
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.measurement import Measurement
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import TrackSettings
from wayside.stages.detection import BoxClassifier
from wayside.stages.geometry import FrenetOffset
from wayside.stages.kernels import Array, Flags
from wayside.stages.mapping.association import NEAREST_M, Hypotheses, pair_hypotheses
from wayside.stages.mapping.landmark import build_landmark, measure_landmark
from wayside.stages.mapping.landmark_evidence import (
    PLACE,
    SURROUNDINGS,
    LandmarkClassifier,
    LandmarkEvidence,
    SignPlaces,
    view_features,
)
from wayside.stages.mapping.landmark_fit import BOX_SIGMA, LandmarkFit, accept_greedily
from wayside.stages.mapping.local_adjustment import LandmarkMeasurement
from wayside.stages.mapping.panel import PanelMeasurement, PanelModels, measure_panel
from wayside.stages.mapping.prediction import add_predicted_views
from wayside.stages.mapping.surroundings import surroundings_correlation
from wayside.stages.mapping.verdicts import (
    VERDICT_OF_TERM,
    FaceBoxes,
    in_swept_volume,
    same_face,
)
from wayside.stages.mapping.window import (
    TravelledPath,
    WindowFrame,
    WindowPoses,
    candidates_of,
    untracked,
)

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
    panel: PanelModels | None = None,
    jointly: bool = False,
    box_sigma: tuple[float, float] = BOX_SIGMA,
) -> Iterator[TrackedFrame]:
    """Decide every candidate: measure it as a landmark with its other views, or say why not.

    Frames come out in order, each once, at most `longest` + `WINDOW_STEP` used frames late. A landmark comes with the
    first frame that it was seen in.

    `front`: classifiers of faces: of landmarks (None: each whose views agree is a sign) and of predicted views (None:
    no views are predicted). `back`: the same for panels seen from behind. None: they are not tracked. `panel`: models
    that measure panels as planes. None: boxes alone give position and size. `jointly`: whether a landmark is adjusted
    together with the motion. `box_sigma`: scatter of the centres of boxes, as `BOX_SIGMA`.
    """
    sides = {False: front or SideClassifiers()} | ({} if back is None else {True: back})
    yield from _Tracker(settings, sides, box_sigma, PAIR_REACH, panel, jointly).run(posed)


class _Classified(NamedTuple):
    """A fitted landmark with what decides on it."""

    fit: LandmarkFit
    offset: FrenetOffset
    evidence: LandmarkEvidence
    accepted: bool


def _in_one_size(posed: PosedDetections, grey: bool) -> PosedDetections:
    """The frame with its image in colour or in grey only: at most three quarters of what the window would hold."""
    found = posed.detections.segmentation
    frame, unneeded = replace(posed.frame, data=b""), "rgb" if grey else "grey"
    image = replace(found.image, frame=frame, **{unneeded: None})
    detections = replace(posed.detections, segmentation=replace(found, image=image, labels=None))
    return replace(posed, detections=detections)


@dataclass
class WindowSolver(ABC):
    """A window of frames with the hypotheses of each, solved every `WINDOW_STEP` frames."""

    settings: TrackSettings
    sides: dict[bool, SideClassifiers]
    box_sigma: tuple[float, float]
    reach: int
    grey: ClassVar = False
    """Whether images are needed in grey, not in colour."""

    def __post_init__(self) -> None:
        """Start without frames."""
        self._length = self.settings.longest + WINDOW_STEP
        self._path = TravelledPath(self._length + self.settings.longest)
        self._window: list[WindowFrame] = []
        self._hypotheses: list[Hypotheses] = []
        self._next_id = 0

    def run(self, posed: Iterator[PosedDetections]) -> Iterator[TrackedFrame]:
        """Send frames through the window; each comes out once, in order, when it cannot change any more."""
        waiting: deque[PosedDetections | WindowFrame] = deque()
        for item in (_in_one_size(one, self.grey) for one in posed):
            camera = item.frame.camera
            if item.motion is None or camera is None:
                waiting.append(item)
            else:
                frame = WindowFrame.of(item, item.motion, camera)
                waiting.append(frame)
                self.append(frame)
            yield from self._released(waiting)
        if self._window:
            self._solve(last=True)
        self._window.clear()
        yield from self._released(waiting)

    def _released(self, waiting: deque[PosedDetections | WindowFrame]) -> Iterator[TrackedFrame]:
        """The first of the frames that wait, up to one whose candidates a landmark may still claim."""
        while waiting and not any(held is waiting[0] for held in self._window):
            first = waiting.popleft()
            if isinstance(first, WindowFrame):
                yield first.finished()
            else:
                yield untracked(first, first.detections.candidates)

    def append(self, frame: WindowFrame) -> None:
        """Take the next frame; a full window is solved, and its oldest frames leave."""
        self._window.append(frame)
        self._path.append(frame.motion)
        self._hypotheses.append(self._pairs_of_newest())
        if len(self._window) >= self._length:
            self._solve(last=False)
            del self._window[:WINDOW_STEP], self._hypotheses[:WINDOW_STEP]

    def _likely(self, recent: Sequence[WindowFrame]) -> NDArray[np.int64] | None:
        """Pairs (k, 2) of candidates of these frames, the second of the last, that may show a panel; None: any."""
        return None

    def _fits(self) -> list[LandmarkFit]:
        """Landmarks of the unassigned candidates, faces before backs."""
        hypotheses, candidates = Hypotheses.joined(self._hypotheses), candidates_of(self._window)
        free = ~candidates.table["assigned"]
        return [
            fit
            for back in self.sides
            for fit in accept_greedily(
                candidates,
                hypotheses.select(hypotheses.back == back),
                free & (candidates.table["back"] == back),
                self.settings,
                self.box_sigma,
            )
        ]

    @abstractmethod
    def _settle(self, passed: list[LandmarkFit], ahead: list[LandmarkFit]) -> None:
        """Decide landmarks that the vehicle has passed; those that have to wait join the ones ahead."""

    def _pairs_of_newest(self) -> Hypotheses:
        """Hypotheses from the newest frame with each of the few before it."""
        recent = self._window[-1 - self.reach :]
        newest = len(recent) - 1
        if newest == 0:
            return Hypotheses(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0, np.bool_))
        candidates = candidates_of(recent)
        first, gap_px, likely = candidates.first, self.settings.gap_px, self._likely(recent)
        pairs, found = pair_hypotheses(candidates, range(newest), newest, gap_px, likely)
        paired = np.zeros((first[-1], 2), np.bool_)
        paired[pairs[:, 0], 1] = paired[pairs[:, 1], 0] = True
        for held, own in zip(recent, np.split(paired, first[1:-1]), strict=True):
            held.followed["paired"] |= own
        return found

    def _solve(self, *, last: bool) -> None:
        """Decide the landmarks of the window that the vehicle has passed."""
        passed, ahead = list[LandmarkFit](), list[LandmarkFit]()
        fits = self._fits()
        for fit, behind in zip(fits, self._passed(fits), strict=True):
            (passed if last or behind else ahead).append(fit)
        self._settle(passed, ahead)
        for fit in ahead:
            # views that leave the window though their landmark is still in sight
            for k, row in zip(fit.frames, fit.rows, strict=True):
                if k < WINDOW_STEP:
                    self._window[k].followed["standing"][row] = True

    def _report(self, fit: LandmarkFit, measured: LandmarkMeasurement, **more: Any) -> Landmark:
        """Hand a landmark to its first frame, and take its candidates; more: its other columns."""
        landmark = build_landmark(fit, self._window, measured, track_id=self._next_id, **more)
        self._window[fit.frames[0]].landmarks.append(landmark)
        for k, row in zip(fit.frames.tolist(), fit.rows.tolist(), strict=True):
            self._window[k].followed["assigned"][row] = True
        self._next_id += 1
        return landmark

    def _passed(self, fits: Sequence[LandmarkFit]) -> Flags:
        """Which landmarks lie outside the newest image, or too near to be seen in the next."""
        newest, points = self._window[-1], np.reshape([fit.point for fit in fits], (-1, 3))
        local, (low, high) = newest.motion.pose.to_camera(points), newest.bounds.reshape(2, 2)
        rays = local[:, :2] / local[:, 2:]
        return (local[:, 2] < NEAREST_M) | ~((low < rays) & (rays < high)).all(axis=1)


@dataclass
class _Tracker(WindowSolver):
    """The tracker of preset `default`; `track` describes its settings."""

    panel: PanelModels | None
    jointly: bool

    def __post_init__(self) -> None:
        super().__post_init__()
        self._places = {back: SignPlaces() for back in self.sides}
        self._reported: list[LandmarkFit] = []
        self._images: WindowPoses

    def _settle(self, passed: list[LandmarkFit], ahead: list[LandmarkFit]) -> None:
        """Most likely signs first; one waits where another that may be a sign, on the same pixels, is in sight."""
        oldest = self._window[0].motion.pose
        self._reported = [one for one in self._reported if not oldest.to_camera(one.point)[2] < 0]
        self._images = WindowPoses.of(self._window)
        views = {back: side.view for back, side in self.sides.items() if side.view is not None}
        ranked = self._ranked(add_predicted_views(passed, self._window, views))
        boxes = FaceBoxes.of([one.fit for one in ranked], self._images)
        near = same_face(boxes.select(np.s_[:, None]), FaceBoxes.of(ahead, self._images))
        settled = list[int]()
        for k, one in enumerate(ranked):
            rivals = np.flatnonzero(near[k] & one.accepted)
            if any(rival.accepted for rival in self._seen([ahead[other] for other in rivals])):
                ahead.append(one.fit)
            else:
                settled.append(k)
        self._decide([ranked[k] for k in settled], boxes.select(settled))

    def _seen(self, fits: Sequence[LandmarkFit]) -> list[_Classified]:
        """Landmarks with the evidence for each but for its surroundings."""
        placed = zip(fits, self._path.offsets([fit.point for fit in fits]), strict=True)
        return [self._classify(f, offset, view_features(f, self._window)) for f, offset in placed]

    def _classify(self, fit: LandmarkFit, offset: FrenetOffset, features: Array) -> _Classified:
        """A landmark with the evidence for it, among the signs that are known by now."""
        features[PLACE] = self._places[fit.back].log_density(offset)
        classifier = self.sides[fit.back].landmark
        evidence = classifier.classify(features, fit.value)
        return _Classified(fit, offset, evidence, classifier.accepts(evidence))

    def _surrounded(self, one: _Classified) -> _Classified:
        """The landmark with the evidence of its surroundings, see `surroundings_correlation`."""
        images = [self._window[k].rgb for k in one.fit.frames.tolist()]
        views = zip(images, one.fit.seen["box"], strict=True)
        features, seen = one.evidence.features.copy(), ((i, b) for i, b in views if i is not None)
        features[SURROUNDINGS] = surroundings_correlation(seen)
        return self._classify(one.fit, one.offset, features)

    def _ranked(self, fits: Sequence[LandmarkFit]) -> list[_Classified]:
        """Landmarks, likeliest signs first; the surroundings of what cannot be a sign without them are not measured."""
        found = [self._surrounded(one) if one.accepted else one for one in self._seen(fits)]
        return sorted(found, key=lambda one: -one.evidence.log_odds)

    def _decide(self, ranked: Sequence[_Classified], boxes: FaceBoxes) -> None:
        """Give landmarks, in these boxes, their verdicts in their order, and measure them."""
        each = boxes.select(np.s_[:, None])
        reported = FaceBoxes.of(self._reported, self._images)
        explained = np.asarray(same_face(each, reported).any(axis=1))
        for k, one in enumerate(ranked):  # once more: the surer ones say where signs stand
            now = self._classify(one.fit, one.offset, one.evidence.features.copy())
            if now.accepted and np.isnan(now.evidence.features[SURROUNDINGS]):
                now = self._surrounded(now)
            verdict = self._verdict(now, explained=explained[k])
            if verdict == "sign":
                self._finish(now, *self._measured(now))
                newest = FaceBoxes.of(self._reported[-1:], self._images)
                explained |= same_face(each, newest).any(axis=1)
            else:
                by_boxes = measure_landmark(one.fit, self._window)
                self._finish(now, verdict, by_boxes, PanelMeasurement())

    def _verdict(self, one: _Classified, *, explained: np.bool_) -> str:
        """The verdict on a landmark by all but the images; `explained`: a sign is on its pixels."""
        if in_swept_volume(one.fit, one.offset):
            return "moving"
        if not one.accepted:
            return VERDICT_OF_TERM[one.evidence.weakest]
        return "duplicate" if explained else "sign"

    def _measured(self, one: _Classified) -> tuple[str, LandmarkMeasurement, PanelMeasurement]:
        """A landmark that may be a sign, and its panel, with the verdict of its images; nothing else changes."""
        fit, panel = one.fit, PanelMeasurement()
        if self.panel is not None:
            panel = measure_panel(fit, self._window, one.offset, self.panel)
        # any two rays meet somewhere: where nothing is known of signs, images in register confirm it
        known = self.sides[fit.back].landmark.model is not None
        confirmed = bool(known or fit.used.sum() > 2 or len(panel.views) > 1)
        jointly = self.jointly and confirmed
        landmark = measure_landmark(fit, self._window, panel.panel, jointly)
        return "sign" if confirmed else "residual", landmark, panel

    def _finish(
        self, one: _Classified, verdict: str, measured: LandmarkMeasurement, seen: PanelMeasurement
    ) -> None:
        """Hand a landmark with its verdict to its first frame."""
        fit, evidence = one.fit, one.evidence
        decided: dict[str, Any] = {"score": evidence.score, "verdict": verdict, "posts": seen.posts}
        shown = {"features": array("d", evidence.features), "evidence": evidence.ratios}
        (decided["offset"],) = self._path.offsets([measured.point])
        landmark = self._report(fit, measured, **decided, **shown)
        if verdict == "sign":
            # Its panel as it was measured: boxes around a sign and its plaque would make the plaque a duplicate.
            size = np.array([landmark.width_m, landmark.height_m])
            face = replace(fit, point=measured.point, metric=size)
            self._reported.append(face)
            self._places[fit.back].add(one.offset, evidence.best_score)
        if seen.views or measured.residual is not None:
            number, shape = landmark.track_id, None if seen.outline is None else seen.outline.shape
            self._window[fit.frames[0]].measurements.append(
                Measurement(number, seen.views, seen.segments, shape, seen.face, measured.residual)
            )
