"""Receives every item of the flow and sends its entities to the recordings; no stage knows of it."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import rerun as rr

from wayside.pipeline.files.output_folder import RECORDING
from wayside.pipeline.results.inventory import WrittenTables
from wayside.pipeline.view import entities as at
from wayside.pipeline.view.chains import closing, opening
from wayside.pipeline.view.entities import Batch, Bundle, Entity, Times
from wayside.pipeline.view.recorder import Recorder
from wayside.pipeline.view.views import LAST_STAGE, ViewState, active_landmarks, entities_of
from wayside.pipeline.workers import Item
from wayside.schemas.frame import Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.models import GaussianModel
from wayside.schemas.motion import PosedDetections


class RerunObserver:
    """Turns items into entities in the thread that made them, and sends each frame's in one go, in order.

    Entities of the stages in the workers wait until the motion of their frame is known. Every row then has all
    timelines, also the distance along the road, and only one thread sets times. Faults are kept for the summary; they
    do not reach the run.
    """

    def __init__(
        self,
        recorders: Sequence[Recorder],
        location: GaussianModel,
        *,
        images: str = "all",
        detail: bool = False,
        plane: str | None = None,
    ) -> None:
        self._recorders = tuple(recorders)
        self._state = ViewState(images, detail)
        self._lock = threading.Lock()
        self._waiting: dict[int, list[Entity]] = defaultdict(list)
        self._held_images: dict[int, list[Entity]] = {}
        self._times: dict[int, Times] = {}
        self._plane = plane
        self._planed: set[str] = set()
        self._fault: str | None = None
        self._guarded(lambda: self._send(opening(location)))

    @property
    def images(self) -> str:
        """Which images are recorded."""
        return self._state.images

    @property
    def records(self) -> bool:
        """Whether one of the recordings is the file next to the tables."""
        return any(recorder.name == RECORDING for recorder in self._recorders)

    @property
    def recording_lost(self) -> bool:
        """Whether that file is not whole."""
        failed = any(r.name == RECORDING and r.fault is not None for r in self._recorders)
        return self.records and (failed or self._fault is not None)

    def see(self, stage: str, item: Item) -> None:
        """Take note of what a stage made of a frame."""
        self._guarded(lambda: self._see(stage, item.frame, item))

    def finish(self, inventory: WrittenTables) -> None:
        """Send what is known at the end only."""
        self._guarded(
            lambda: self._send(Bundle(tuple(closing(inventory, self._state, self._times))))
        )

    def close(self) -> list[str]:
        """End all recordings; what went wrong with any, in words."""
        for recorder in self._recorders:
            recorder.close()
        faults = [f"{r.name}: {r.fault}" for r in self._recorders if r.fault is not None]
        faults += [
            f"{r.name}: {r.dropped} frames left out, the viewer was too slow"
            for r in self._recorders
            if r.dropped and r.fault is None
        ]
        return faults if self._fault is None else [self._fault, *faults]

    def _guarded(self, work: Any) -> None:
        if self._fault is not None:
            return
        try:
            work()
        except Exception as fault:
            self._fault = f"no more was recorded after {type(fault).__name__}: {fault}"
            self._waiting.clear()
            self._held_images.clear()

    def _see(self, stage: str, frame: Frame, item: Item) -> None:
        found = entities_of(item, stage, self._state)
        if isinstance(item, TrackedFrame):
            if found:
                self._take_tracked(stage, frame, found)
            return
        with self._lock:
            self._waiting[frame.index] += found
        if isinstance(item, PosedDetections):
            self._take_posed(frame, item)

    def _take_posed(self, frame: Frame, item: PosedDetections) -> None:
        with self._lock:
            found = self._waiting.pop(frame.index, [])
        station = None if item.motion is None else item.motion.station_m
        times = Times.of(frame, station)
        if item.motion is not None:
            self._times[frame.index] = times
        if self._state.images == "signs":
            self._held_images[frame.index] = [e for e in found if e.path == at.IMAGE]
            found = [e for e in found if e.path != at.IMAGE]
        self._send(Batch(times, tuple(found)))

    def _take_tracked(self, stage: str, frame: Frame, found: tuple[Entity, ...]) -> None:
        image: list[Entity] = []
        if stage == LAST_STAGE:
            image = self._held_images.pop(frame.index, [])
            active = active_landmarks(self._state, frame.index)
            if not any(landmark.verdict == "sign" for landmark in active):
                image = []
        self._send(Batch(self._times[frame.index], (*image, *found)))

    def _send(self, item: Batch | Bundle) -> None:
        if self._plane is not None:
            item = Bundle((Batch(None, tuple(self._on_plane(item, self._plane))), item))
        for recorder in self._recorders:
            recorder.put(item)

    def _on_plane(self, item: Batch | Bundle, plane: str) -> Iterator[Entity]:
        """Once for each layer of the image: the coordinate frame that it lies in."""
        for path in item.paths():
            if path.startswith(f"{at.CAMERA}/") and path not in self._planed:
                self._planed.add(path)
                yield Entity(path, (rr.CoordinateFrame(plane),))
