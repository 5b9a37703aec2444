"""Sees every item on its way past, and hands what it looks like to the recordings; no stage knows of it."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import rerun as rr

from wayside.pipeline.inventory import Inventory
from wayside.pipeline.view import entities as at
from wayside.pipeline.view.chains import closing, opening
from wayside.pipeline.view.entities import Batch, Bundle, Entity, Times
from wayside.pipeline.view.recorder import Recorder
from wayside.pipeline.view.views import LAST_STAGE, Scene, entities_of, seen_places
from wayside.pipeline.workers import Item
from wayside.schemas.frame import Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.models import GaussianModel
from wayside.schemas.motion import PosedDetections


class RerunObserver:
    """Turns items into entities in the thread that made them, and sends each frame's in one go, in order.

    What the workers see of a frame waits until its motion is known, so that every row has all timelines, the distance
    along the road included, and only one thread ever sets a time. Faults are kept for the summary; the run never
    feels them.
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
        self._scene = Scene(images, detail)
        self._lock = threading.Lock()
        self._waiting: dict[int, list[Entity]] = defaultdict(list)
        self._pictures: dict[int, list[Entity]] = {}
        self._times: dict[int, Times] = {}
        self._plane = plane
        self._planed: set[str] = set()
        self._fault: str | None = None
        self._guarded(lambda: self._send(opening(location)))

    @property
    def images(self) -> str:
        """Which pictures are recorded."""
        return self._scene.images

    def see(self, stage: str, item: Item) -> None:
        """Take note of what a stage made of a frame."""
        self._guarded(lambda: self._see(stage, item.frame, item))

    def finish(self, inventory: Inventory) -> None:
        """Send what only the end tells."""
        self._guarded(
            lambda: self._send(Bundle(tuple(closing(inventory, self._scene.poses, self._times))))
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
            self._pictures.clear()

    def _see(self, stage: str, frame: Frame, item: Item) -> None:
        found = entities_of(item, stage, self._scene)
        if isinstance(item, TrackedFrame):
            if found:
                self._settled(stage, frame, found)
            return
        with self._lock:
            self._waiting[frame.index] += found
        if isinstance(item, PosedDetections):
            self._moved(frame, item)

    def _moved(self, frame: Frame, item: PosedDetections) -> None:
        with self._lock:
            found = self._waiting.pop(frame.index, [])
        station = None if item.motion is None else item.motion.station_m
        times = Times.of(frame, station)
        if item.motion is not None:
            self._times[frame.index] = times
        if self._scene.images == "signs":
            self._pictures[frame.index] = [e for e in found if e.path == at.IMAGE]
            found = [e for e in found if e.path != at.IMAGE]
        self._send(Batch(times, tuple(found)))

    def _settled(self, stage: str, frame: Frame, found: tuple[Entity, ...]) -> None:
        picture: list[Entity] = []
        if stage == LAST_STAGE:
            picture = self._pictures.pop(frame.index, [])
            seen = seen_places(self._scene, frame.index)
            if not any(place.verdict == "sign" for place in seen):
                picture = []
        self._send(Batch(self._times[frame.index], (*picture, *found)))

    def _send(self, item: Batch | Bundle) -> None:
        if self._plane is not None:
            item = Bundle((Batch(None, tuple(self._on_plane(item, self._plane))), item))
        for recorder in self._recorders:
            recorder.put(item)

    def _on_plane(self, item: Batch | Bundle, plane: str) -> Iterator[Entity]:
        """Once for each layer of the picture: the coordinate frame that it lies in."""
        for path in item.paths():
            if path.startswith(f"{at.CAMERA}/") and path not in self._planed:
                self._planed.add(path)
                yield Entity(path, (rr.CoordinateFrame(plane),))
