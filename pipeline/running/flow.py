"""Runs a chain of stages over a log: workers, order, journal, clock, observer. It knows no stage by what it does."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from wayside.pipeline.chains import Chain, chain_of, profile_stage
from wayside.pipeline.files.route_file import RouteFile
from wayside.pipeline.image_memory import ImageMemory
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.running.journal import Journal
from wayside.pipeline.workers import Item, Stage, StageClock, Workers
from wayside.schemas.detections import Detections
from wayside.schemas.frame import Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.roadside import CrossSection
from wayside.schemas.settings import Settings
from wayside.schemas.signs import Sign
from wayside.stages.calibration import DriveCalibration
from wayside.stages.georeference import DrivePath
from wayside.stages.roadside import on_road

QUEUED = 2
"""Images under way for each worker, at most: with three a run is 2 % faster and takes 20 MB more."""


class Observer(Protocol):
    """Sees every item that leaves a stage, in the thread that made it."""

    def see(self, stage: str, item: Item) -> None:
        """Record the item; must not raise and must not keep the run waiting."""


@dataclass(slots=True)
class FrameCounts:
    """Numbers of frames that are analysed one by one, and of frames that the ordered stages have finished."""

    looked_at: int = 0
    settled: int = 0


@dataclass(frozen=True, slots=True)
class Drive:
    """What is known after the last frame."""

    path: DrivePath
    signs: tuple[Sign, ...]
    """In the order of their numbers."""
    lens: DriveCalibration | None
    """The lens by the drive; None where the drive does not determine it."""
    sections: tuple[CrossSection, ...] | None = None
    """Of the road, in the order of the route. None: not asked for."""


@dataclass(slots=True)
class Flow:
    """A chain under way; one instance serves one log."""

    settings: Settings
    models: Models
    clock: StageClock
    observer: Observer | None = None
    journal: Journal | None = None
    routes: RouteFile | None = None
    memory: ImageMemory = field(default_factory=ImageMemory)
    counts: FrameCounts = field(default_factory=FrameCounts)
    workers: Workers = field(init=False)
    chain: Chain = field(init=False)

    def __post_init__(self) -> None:
        """Build the chain of the preset; its networks are shared by all workers."""
        self.workers = Workers(self.settings.run.workers)
        self.chain = chain_of(self.settings, self.models, self.routes)

    def track(self, frames: Iterator[Frame]) -> Iterator[TrackedFrame]:
        """Send frames all the way: every frame comes out once, in order, with the landmarks first seen in it."""
        read, memory = self._shown(Stage("read", self.memory.taken), frames), self.memory
        with self.workers as workers:
            found = workers.ordered(self._find, read, QUEUED, lambda: memory.has_room)
            if self.journal is not None:
                found = self.clock.timed("journal", self.journal.record(found))
            for settled in self._follow(self._counted(self.clock.timed("queue", found))):
                self.counts.settled += 1
                yield settled
        self.chain.per_image.clear()  # and with it the memory of the images

    def detect(self, frames: Iterator[Frame]) -> Iterator[Detections]:
        """Do the work on one image that needs no other image; runs side by side in the workers."""
        return self._through(self.chain.per_image, frames)

    def finish(self) -> Drive:
        """After the last frame: the path of the whole drive, the signs on it, and what it says of its lens."""
        own = self.chain
        (path,) = self._of_drive([own.path], iter(own.record.points))
        sections = None
        if own.roadside is not None:
            sections = tuple(self._of_drive([profile_stage(path)], iter(own.roadside)))
            path = on_road(path, sections)
        signs = tuple(self._of_drive(own.signs(path), iter(own.record.landmarks)))
        lens = next(self._of_drive([own.lens], iter([own.calibration])), None)
        return Drive(path, signs, lens, sections)

    def _counted(self, found: Iterator[Detections]) -> Iterator[Detections]:
        for item in found:
            self.counts.looked_at += 1
            yield item

    def _find(self, frames: Iterator[Frame]) -> Iterator[Detections]:
        """Take from the journal what an earlier run has found in a frame, else detect."""
        for frame in frames:
            known = None
            if self.journal is not None and frame.index in self.journal:
                (image,) = self._through(self.chain.per_image[:1], iter([frame]))
                known = self.journal.replay(image)
            yield from self.detect(iter([frame])) if known is None else (known,)

    def _follow(self, detections: Iterator[Detections]) -> Iterator[TrackedFrame]:
        """Do what needs the frames in order. Pixels are held until the frame is tracked, or has no motion."""
        items: Iterator[Any] = detections
        for stage in self.chain.per_frame:
            items = self._shown(stage, items)
            if stage.name == "motion":
                items = self.memory.released(items, lambda one: one.motion is None)
            elif stage.name == "track":
                items = self.memory.released(items, lambda one: True)
        return items

    def _through(self, stages: Sequence[Stage[Any, Any]], items: Iterator[Any]) -> Iterator[Any]:
        for stage in stages:
            items = self._shown(stage, items)
        return items

    def _shown(self, stage: Stage[Any, Any], items: Iterator[Any]) -> Iterator[Any]:
        """The items of a stage: timed, its faults named, and every item shown to the observer."""
        found = self.clock.timed(stage.name, stage.run(items))
        if self.observer is None or not stage.seen:
            return found
        see = self.clock.apart("view", partial(self.observer.see, stage.name))
        return (item for item in found if see(item) is None)

    def _of_drive(self, stages: Sequence[Stage[Any, Any]], items: Iterator[Any]) -> Iterator[Any]:
        """The items of stages after the last frame: timed, their faults named."""
        for stage in stages:
            items = self.clock.timed_drive(stage.name, stage.run(items))
        return items


def paced(
    frames: Iterator[Frame],
    rate: float,
    *,
    now: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Frame]:
    """Hold each frame back until its time has come, counted from the first, at `rate` times the recorded speed.

    A frame that comes late goes on at once, and the later ones keep to the same clock.
    """
    start: float | None = None
    first_ns = 0
    for frame in frames:
        if start is None:
            start, first_ns = now(), frame.time_ns
        wait = start + (frame.time_ns - first_ns) / 1e9 / rate - now()
        if wait > 0:
            sleep(wait)
        yield frame
