"""The way of a frame from the log to a sign: which stage follows which.

Read it beside the report: K-means, difference image, K-means again, size gate (chapters 2 and 3.1); colour
(3.2); shape (4); SIFT (5); motion by straight line and adjustment (7 and 8); matching and triangulation (5, 7);
location (8, 11).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import thread_time
from typing import Any, Protocol

from wayside.pipeline.model_files import Models
from wayside.pipeline.workers import StageClock, ordered_parallel, staged
from wayside.schemas.frame import Frame
from wayside.schemas.models import SideJudges
from wayside.schemas.motion import Settled
from wayside.schemas.regions import Look
from wayside.schemas.settings import Settings
from wayside.stages.assemble import assemble
from wayside.stages.color import classify_color
from wayside.stages.decode import decode
from wayside.stages.features import extract_features
from wayside.stages.judge import judge
from wayside.stages.locate import classify_location
from wayside.stages.motion import estimate_motion
from wayside.stages.propose import propose
from wayside.stages.segment import segment
from wayside.stages.shape import classify_shape
from wayside.stages.track import track


class Observer(Protocol):
    """Sees every item that leaves a stage, in the thread that made it."""

    def see(self, stage: str, frame: Frame, item: Any) -> None:
        """Take note; must not raise and must not keep the run waiting."""


@dataclass(frozen=True, slots=True)
class Flow:
    """The chain with its settings and models; one instance serves one log."""

    settings: Settings
    models: Models
    clock: StageClock
    observer: Observer | None = None

    def signs(self, frames: Iterator[Frame]) -> Iterator[Settled]:
        """Send frames all the way: every frame comes out once, in order, with what ended there."""
        run = self.settings.run
        looks = ordered_parallel(self.look, frames, workers=run.workers, queue=run.queue)
        return self.follow(looks)

    def look(self, frames: Iterator[Frame]) -> Iterator[Look]:
        """Do what one picture needs for itself; runs side by side in the workers."""
        s, m = self.settings, self.models
        by_report = s.candidates.judge == "report"
        pictures = self._stage("decode", frames, decode)
        segmented = self._stage("segment", pictures, segment, settings=s.segment, gate=s.gate)
        if not by_report:
            segmented = self._stage(
                "propose", segmented, propose, settings=s.candidates, ranking=m.ranking
            )
        judged = self._stage("color", segmented, classify_color, model=m.color, gate=by_report)
        if not by_report:
            judged = self._stage(
                "judge",
                judged,
                judge,
                trees=m.judge,
                settings=s.candidates,
                color=m.face_color,
                shape=m.face_shape,
                box=m.face_box,
                back=m.back,
            )
        judged = self._stage("shape", judged, classify_shape, model=m.shape, gate=by_report)
        return self._stage("features", judged, extract_features, settings=s.features)

    def follow(self, looks: Iterator[Look]) -> Iterator[Settled]:
        """Do what needs the frames in order: motion, tracks, places, signs."""
        s, m = self.settings, self.models
        moved = self._stage("motion", looks, estimate_motion, settings=s.motion)
        front = SideJudges(None if s.candidates.judge == "report" else m.judge, m.place)
        back = None if m.back is None else SideJudges(m.back, m.back_place)
        settled = self._stage("track", moved, track, settings=s.track, front=front, back=back)
        settled = self._stage(
            "location", settled, classify_location, model=m.location, settings=s.locate
        )
        return self._stage("assemble", settled, assemble)

    def _stage(
        self, name: str, items: Iterator[Any], stage: Callable[..., Iterator[Any]], **how: Any
    ) -> Iterator[Any]:
        results = staged(name, lambda own: stage(own, **how), items, self.clock, frame_index)
        return observed(name, results, self.observer, self.clock)


def observed(
    name: str, items: Iterator[Any], observer: Observer | None, clock: StageClock
) -> Iterator[Any]:
    """Show every item to the observer, if there is one; its time is counted as that of a stage `view`."""
    if observer is None:
        yield from items
        return
    for item in items:
        frame = frame_of(item)
        if frame is not None:
            start = thread_time()
            observer.see(name, frame, item)
            clock.add("view", thread_time() - start)
        yield item


def frame_of(item: Any) -> Frame | None:
    """The frame that any travelling type belongs to."""
    for holder in ("look", "segmented", "picture", "frame"):
        while hasattr(item, holder):
            item = getattr(item, holder)
    return item if isinstance(item, Frame) else None


def frame_index(item: Any) -> int | None:
    """Index of the frame that any travelling type belongs to."""
    frame = frame_of(item)
    return None if frame is None else frame.index
