"""The report's matching: by SIFT from frame to frame, placed by two views (chapters 5 and 7)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from wayside.schemas.detections import Features
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import SiftSettings, TrackSettings
from wayside.stages.mapping import (
    Fit,
    Gates,
    Held,
    Scatter,
    TravelledPath,
    build_place,
    fit_views,
    measured_place,
    sightings_of,
    through_window,
)
from wayside.stages.report.sift_matching import match_points, vote_regions

REPORT_SCORE = 1.0
"""Log odds given to every sign: the report judges by gates alone and states no probability."""


def match_by_descriptors(
    moved: Iterator[PosedDetections], settings: TrackSettings, sift: SiftSettings
) -> Iterator[TrackedFrame]:
    """Chain candidates from frame to frame by their key points; each chain is placed by its two nearest views.

    Frames come out in order, each once, when no open chain holds them, at most `settings.longest` used frames late;
    what a chain saw earlier than that is left `unmatched`.
    """
    yield from through_window(moved, _Matcher(settings, sift))


@dataclass(frozen=True, slots=True)
class _Chain:
    """Views of one thing so far: (frame, followed candidate), oldest first."""

    views: tuple[tuple[Held, int], ...]


class _Matcher:
    """Open chains, and the frames that they hold."""

    def __init__(self, settings: TrackSettings, sift: SiftSettings) -> None:
        self._settings, self._sift = settings, sift
        self._gates = Gates(gap_px=settings.gap_px)
        self._path = TravelledPath(2 * settings.longest)
        self._held: list[Held] = []
        self._features: Features | None = None
        self._chains: dict[int, _Chain] = {}  # by followed candidate of the newest frame
        self._next_id = 0

    def holds(self, one: Held) -> bool:
        """Whether a chain may still claim candidates of the frame."""
        return any(h is one for h in self._held)

    def append(self, one: Held, features: Features) -> None:
        """Take the next frame: chains go on or end."""
        going: dict[int, _Chain] = {}
        if self._features is not None:
            before, previous = self._held[-1], self._features
            pairs = match_points(
                previous.sign_descriptors, features.sign_descriptors, self._sift.ratio
            )
            local_before, local_now = _faces(before), _faces(one)
            for a, b in vote_regions(pairs, previous.sign_rows, features.sign_rows):
                old, new = local_before.get(int(a)), local_now.get(int(b))
                if old is None or new is None:
                    continue
                chain = self._chains.pop(old, _Chain(((before, old),)))
                before.linked[old, 1] = one.linked[new, 0] = True
                going[new] = _Chain((*chain.views, (one, new))[-self._settings.longest :])
        ended = list(self._chains.values())
        self._held.append(one)
        self._path.append(one.motion)
        self._end(ended)
        self._chains, self._features = going, features
        self._let_go()

    def finish(self) -> None:
        """End all chains: nothing more comes."""
        self._end(list(self._chains.values()))
        self._chains = {}
        self._held = []

    def _let_go(self) -> None:
        wanted = {id(h) for chain in self._chains.values() for h, _ in chain.views}
        wanted.add(id(self._held[-1]))
        while id(self._held[0]) not in wanted:
            del self._held[0]

    def _end(self, chains: list[_Chain]) -> None:
        if not chains:
            return
        sightings = sightings_of(self._held)
        at = {id(h): i for i, h in enumerate(self._held)}
        for chain in chains:
            if len(chain.views) < self._settings.fewest_views:
                continue
            frames = np.array([at[id(h)] for h, _ in chain.views])
            rows = sightings.first[frames] + np.array([row for _, row in chain.views])
            fit = fit_views(sightings, rows, frames, nearest=2)
            if fit is not None:
                self._settle(fit, chain)

    def _settle(self, fit: Fit, chain: _Chain) -> None:
        beside = self._path.beside(fit.point)
        tall_px = fit.metric[1] / fit.depth.min() * self._held[fit.frames[-1]].focal
        allowed = self._gates.gap_px + self._gates.gap_share * tall_px
        verdict = "sign" if fit.rms_px < allowed else "residual"
        factor = Scatter().factor(fit.chi, fit.freedom)
        weighed = replace(fit, ray_sigma=fit.ray_sigma * np.sqrt(factor))
        place = build_place(
            weighed,
            self._held,
            measured_place(weighed, self._held),
            beside,
            track_id=self._next_id,
            score=REPORT_SCORE,
            verdict=verdict,
        )
        self._held[fit.frames[0]].places.append(place)
        for (held, row), residual in zip(chain.views, fit.residual_px, strict=True):
            held.claim(row, self._next_id, verdict, float(residual))
        self._next_id += 1


def _faces(held: Held) -> dict[int, int]:
    """Number among the followed ones of each row that is followed as a face."""
    return {int(row): i for i, row in enumerate(held.open) if not held.back[i]}
