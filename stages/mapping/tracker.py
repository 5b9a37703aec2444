"""Follows candidates from frame to frame and places what they show (report chapters 5, 7 and 8).

A thing that stands still is one point that all its views agree on. Every pair of candidates up to three frames apart
that could be one thing proposes a place; each place looks for its views in all frames held; the best takes its
candidates away, then the rest is solved again. A place is final when the vehicle has passed it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Features
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import LocalAdjustmentSettings, TrackSettings
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.association import Gates, Sightings, link
from wayside.stages.mapping.classifiers import SideClassifiers
from wayside.stages.mapping.hypotheses import Fit, overlap_share, solve_places
from wayside.stages.mapping.landmark import build_place, judge_place, measured_place, place_features
from wayside.stages.mapping.panel import Panel, measure_panel
from wayside.stages.mapping.prediction import follow_back
from wayside.stages.mapping.residual_scale import Scatter
from wayside.stages.mapping.window import (
    Held,
    TravelledPath,
    frames_of,
    local_rows,
    sightings_of,
    through_window,
)
from wayside.stages.panel import PanelMethod

LINK_REACH = 3
"""Candidates are linked over this many frames at most: one or two may be missing between."""
FEWEST_FOUND = 2
"""Views that place a thing; those it still lacks are looked for where it must be."""
HOP = 4
"""Frames between two looks at the whole window."""
LEAST_TOTAL = -1.0
"""Sum of values over the views from which a place is looked at at all."""
THIRD, SURE_VIEWS = 3, 5
"""Boxes that agree on a place by more than chance, and views from which a place needs no two that look alike."""
STANDS_PX, PAIR_PX = 1.5, 0.5
"""Largest gap between the registered pictures of a standing panel and its place (that of boxes is gated by itself), and
of only two, which are always near to where their rays pass each other (19 of 20 are nearer)."""
SURE, CERTAIN = 2.2, 4.0
"""Log odds from which a place of two pictures that look alike is believed (nine to one), and from which one of three is
whatever they look like (fifty to one): a branch or the edge of a picture may make each look different."""
REST_M = 2.0
"""How far round a duplicate the faces stand that its boxes may have covered."""
LANE_HALF_M, CLEARANCE_M = 1.3, 2.0
"""What the vehicle sweeps beside its path, and above its camera."""
ALIKE_DEPTH, ALIKE_DEPTH_M, ALIKE_SIGMAS, ALIKE_COVER = 0.12, 2.5, 4.0, 0.4
"""Two places are one face where their depths differ less (share, metres or sigmas) and the smaller is covered more."""
AS_WIDE, AS_WIDE_COVER = 0.8, 0.25
"""Widths (narrower by wider) of places of which it must be covered by so much only: the tip of a diamond reaches into
the box of its plaque, but panels of one width stand clear of each other."""


def track(
    moved: Iterator[PosedDetections],
    settings: TrackSettings,
    front: SideClassifiers | None = None,
    back: SideClassifiers | None = None,
    panel: PanelMethod | None = None,
    adjustment: LocalAdjustmentSettings | None = None,
) -> Iterator[TrackedFrame]:
    """Settle every candidate: place it in space with its other views, or say why not.

    Frames come out in order, each once, at most `settings.longest` + 4 used frames late. A place is given with
    the first frame it was seen in.

    Parameters
    ----------
    moved
        Frames with their candidates and motion.
    settings
        How far and by what to follow.
    front
        Judges of faces: of whole places (nobody: every place that holds together is a sign), and of the predicted views
        of places (nobody: only candidates are views).
    back
        The same of panels seen from behind; None: they are not looked for.
    panel
        How panels are measured as planes; None: they are not, boxes alone give position and size.
    adjustment
        How a landmark is adjusted together with the motion; None: it is not.
    """
    front = front or SideClassifiers()
    yield from through_window(moved, _Tracker(settings, front, back, panel, adjustment))


class _Tracker:
    """The window and the places proposed in it."""

    def __init__(
        self,
        settings: TrackSettings,
        front: SideClassifiers,
        back: SideClassifiers | None,
        panel: PanelMethod | None,
        adjustment: LocalAdjustmentSettings | None,
    ) -> None:
        self._settings = settings
        self._panel, self._adjustment = panel, adjustment
        self._sides = {False: front} if back is None else {False: front, True: back}
        self._gates = Gates(gap_px=settings.gap_px)
        self._path = TravelledPath(2 * settings.longest + HOP)
        self._held: list[Held] = []
        self._proposed: list[_Proposed] = []
        self._known: list[Fit] = []  # faces given already
        self._scatter = Scatter()
        self._next_id = 0

    def holds(self, one: Held) -> bool:
        """Whether the frame is still in the window."""
        return any(h is one for h in self._held)

    def append(self, one: Held, features: Features) -> None:
        """Take the next frame; a full window is solved and its oldest frames let go."""
        self._held.append(one)
        self._path.append(one.motion)
        self._proposed.append(self._propose())
        if len(self._held) >= self._settings.longest + HOP:
            self._solve(last=False)
            del self._held[:HOP], self._proposed[:HOP]

    def finish(self) -> None:
        """Solve what is left: nothing more comes."""
        if self._held:
            self._solve(last=True)
        self._held.clear()
        self._proposed.clear()

    def _propose(self) -> _Proposed:
        """Places that the newest frame proposes together with each of the few before it."""
        recent = self._held[-1 - LINK_REACH :]
        sightings = sightings_of(recent)
        newest = len(recent) - 1
        points, sizes, backs = [np.zeros((0, 3))], [np.zeros((0, 2))], [np.zeros(0, np.bool_)]
        for back in self._sides:
            own = replace(sightings, leads=sightings.leads & (_backs(recent) == back))
            for older in range(newest):
                links = link(own, older, newest, self._gates)
                points.append(links.point)
                sizes.append(links.size)
                backs.append(np.full(len(links.point), back))
                recent[older].linked[links.older - sightings.first[older], 1] = True
                recent[newest].linked[links.newer - sightings.first[newest], 0] = True
        return _Proposed(np.concatenate(points), np.concatenate(sizes), np.concatenate(backs))

    def _solve(self, *, last: bool) -> None:
        """Find all places in the window and finish those that the vehicle has passed."""
        proposed = _Proposed(*(np.concatenate(part) for part in zip(*self._proposed, strict=True)))
        doubles = self._solve_round(proposed, last=last)
        if doubles:
            # a box over two faces of which one is known by now: what is left of it may be the other
            away = proposed.point[:, None] - np.array([fit.point for fit in doubles])
            near = (np.linalg.norm(away, axis=2) < REST_M).any(axis=1)
            self._solve_round(_Proposed(*(part[near] for part in proposed)), last=last)

    def _solve_round(self, proposed: _Proposed, *, last: bool) -> list[Fit]:
        """Places of the candidates that are free, finished where passed; those that were faces known already."""
        sightings, held = sightings_of(self._held), self._held
        free = ~np.concatenate([h.taken for h in held])
        done: list[Fit] = []
        for back, judges in self._sides.items():
            own = proposed.back == back
            fits = solve_places(
                sightings,
                proposed.point[own],
                proposed.size[own],
                free & (_backs(held) == back),
                self._gates,
                fewest=self._settings.fewest_views if judges.view is None else FEWEST_FOUND,
                least_total=LEAST_TOTAL,
            )
            done += [replace(f, back=back) for f in fits if last or passed(sightings, f)]
        views = {back: judges.view for back, judges in self._sides.items()}
        if any(view is not None for view in views.values()):
            sightings, done = follow_back(done, held, views[False], self._gates, views.get(True))
        return self._finish_places(sightings, done)

    def _finish_places(self, sightings: Sightings, fits: Sequence[Fit]) -> list[Fit]:
        """Judge finished places, best first, and give them to their frames; returns the duplicates."""
        judged, doubles = [], []
        for fit in fits:
            beside = self._path.beside(fit.point)
            evidence = place_features(fit, self._held, sightings.score[fit.rows], beside)
            judge = self._sides[fit.back].landmark
            judged.append((*judge_place(evidence, judge), fit, beside, evidence))
        judged.sort(key=lambda entry: -entry[0])
        self._known = [f for f in self._known if not behind(sightings, f)]
        for score, passes, fit, beside, evidence in judged:
            verdict = "sign" if passes else "place_score"
            if in_the_way(fit, beside):
                verdict = "moving"
            elif passes and any(same_face(sightings, fit, other) for other in self._known):
                verdict = "duplicate"
                doubles.append(fit)
            factor = self._scatter.factor(fit.chi, fit.freedom)
            alike, panel = 0, None
            if verdict == "sign" and self._panel is not None:
                alike, panel = measure_panel(fit, self._held, beside, self._panel)
            odds = SURE if self._sides[fit.back].landmark is None else score
            if verdict == "sign" and not stands(
                fit, alike, panel, self._settings.fewest_views, odds
            ):
                verdict = "residual"
            if verdict == "sign":
                self._known.append(fit)
                self._scatter.learn(fit.chi, fit.freedom)
            weighed = replace(fit, ray_sigma=fit.ray_sigma * np.sqrt(factor))
            adjustment = self._adjustment if verdict == "sign" else None
            found = measured_place(weighed, self._held, panel, adjustment)
            place = build_place(
                weighed,
                self._held,
                found,
                self._path.beside(found.point),
                track_id=self._next_id,
                score=score,
                verdict=verdict,
                evidence=evidence,
                outline=None if panel is None else panel.shape,
            )
            self._held[fit.frames[0]].places.append(place)
            self._claim(fit, verdict)
            self._next_id += 1
        return doubles

    def _claim(self, fit: Fit, verdict: str) -> None:
        """Write the place's number and verdict to its candidates, and to those it covers, unless it is a duplicate."""
        held, track = self._held, self._next_id
        rows = local_rows(fit.rows, fit.frames, held)
        for frame, row, residual in zip(fit.frames, rows, fit.residual_px, strict=True):
            held[frame].claim(row, track, verdict, residual)
        if verdict == "duplicate":
            return
        frames = frames_of(fit.covered, held)
        for frame, row in zip(frames, local_rows(fit.covered, frames, held), strict=True):
            held[frame].claim(row, track, "overlap", np.nan)


class _Proposed(NamedTuple):
    """Places to try: point (m, 3) in the world, size (m, 2) metres, back (m,): of backs, not of faces."""

    point: NDArray[np.float64]
    size: NDArray[np.float64]
    back: NDArray[np.bool_]


def _backs(held: Sequence[Held]) -> NDArray[np.bool_]:
    """Which of the window's sightings are followed as backs."""
    return np.concatenate([h.back for h in held])


def stands(fit: Fit, alike: int, panel: Panel | None, fewest: int, odds: float) -> bool:
    """Whether the views of a place are of one thing that stands still; `alike` of its pictures look alike.

    Any two rays meet somewhere; that they are of one thing takes a third box to say, or the panel that the registered
    pictures show. Two pictures of a vehicle may meet as well, so there the log odds that the thing is a panel must be
    those of a `SURE` one. And of few boxes, which may be of several things in line, two must look alike, if it is not
    `CERTAIN` that they are of a panel.
    """
    if odds >= CERTAIN and len(fit.rows) >= max(fewest, THIRD):
        return True
    if fit.used.sum() >= max(fewest, THIRD):
        return len(fit.rows) >= SURE_VIEWS or alike >= 2
    if alike >= THIRD:
        return panel is not None and alike >= fewest and panel.residual_px < STANDS_PX
    return odds >= SURE and panel is not None and alike >= fewest and panel.residual_px < PAIR_PX


def in_the_way(fit: Fit, beside: FrenetOffset) -> bool:
    """Whether a place stands where the vehicle drove: nothing stands there, so it moved (at a constant pace)."""
    return bool(abs(beside.right) < LANE_HALF_M and beside.above - fit.metric[1] / 2 < CLEARANCE_M)


def passed(sightings: Sightings, fit: Fit) -> bool:
    """Whether a place can be seen no more: it lies outside the newest picture or too near."""
    x, y, z = (fit.point - sightings.centre[-1]) @ sightings.rotation[-1]
    if z < 4.0:
        return True
    left, top, right, bottom = sightings.bounds[-1]
    return not (left < x / z < right and top < y / z < bottom)


def behind(sightings: Sightings, fit: Fit) -> bool:
    """Whether a place lies behind all cameras of the window."""
    return float((fit.point - sightings.centre[0]) @ sightings.rotation[0][:, 2]) < 0


def same_face(sightings: Sightings, one: Fit, other: Fit) -> bool:
    """Whether a place of this window is one face with another: at like depth, in front of each other.

    A depth that is hardly known (a few far views) is like any depth within its error.
    """
    frame = int(one.frames[-1])
    axis = sightings.rotation[frame][:, 2]
    near, far = sorted(float((f.point - sightings.centre[frame]) @ axis) for f in (one, other))
    alike = max(
        ALIKE_DEPTH * near, ALIKE_DEPTH_M, ALIKE_SIGMAS * np.sqrt(axis @ one.covariance @ axis)
    )
    if near <= 0 or far - near > alike:
        return False
    narrow, wide = sorted((float(one.metric[0]), float(other.metric[0])))
    cover = AS_WIDE_COVER if narrow > AS_WIDE * wide else ALIKE_COVER
    return max(overlap_share(sightings, one, other, frame)) > cover
