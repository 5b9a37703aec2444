"""Receives every item of the flow and sends its entities to recordings, each from a thread of its own."""

import threading
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Full, Queue

import rerun as rr

from wayside.pipeline.files.output_folder import RECORDING
from wayside.pipeline.reading.frames import ReadReport
from wayside.pipeline.results.inventory import WrittenTables
from wayside.pipeline.view import entities as at
from wayside.pipeline.view.blueprint import drive_layout
from wayside.pipeline.view.closing import closing, opening
from wayside.pipeline.view.entities import APPLICATION, Batch, Entity, Times
from wayside.pipeline.view.views import LAST_STAGE, ViewState, active_landmarks, entities_of
from wayside.pipeline.workers import Item
from wayside.schemas.frame import Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.models import GaussianModel
from wayside.schemas.motion import PosedDetections

THREAD = "view-"
WAITING = 48
"""Sets of batches that wait at most."""
PATIENCE_S = 30.0
"""A disk that accepts nothing for this long counts as full or gone; after the run, any sink is abandoned."""


def any_alive() -> bool:
    """Whether a recording's thread still runs; after `close`, one that its sink holds for ever."""
    return any(thread.name.startswith(THREAD) for thread in threading.enumerate())


class Recorder:
    """One recording and the thread that fills it; faults end it and are kept, never raised.

    `name`: a file's name or an address, for messages. `open_stream`: makes the stream with its sink attached; called in
    the thread. `patience_s`: how long `put` waits for a full queue before it gives the recording up (a file). With 0 it
    drops the batches and goes on (a live viewer, which shows the next frame instead).
    """

    def __init__(
        self, name: str, open_stream: Callable[[], rr.RecordingStream], patience_s: float
    ) -> None:
        self.name, self.dropped = name, 0
        self.fault: str | None = None
        self._open, self.patience_s = open_stream, patience_s
        self._queue: Queue[Sequence[Batch] | None] = Queue(WAITING)
        self._thread = threading.Thread(target=self._work, name=f"{THREAD}{name}", daemon=True)
        self._thread.start()

    def put(self, batches: Sequence[Batch]) -> None:
        """Hand over batches, of which none can be left out alone."""
        if self.fault is not None:
            return
        try:
            self._queue.put(batches, timeout=self.patience_s or None, block=self.patience_s > 0)
        except Full:
            self.dropped += 1
            if self.patience_s > 0:
                self.fault = f"accepted no data for {self.patience_s:g} s"

    def close(self) -> None:
        """Wait until all is written, but not for ever."""
        try:
            self._queue.put(None, timeout=PATIENCE_S)
        except Full:
            self.fault = self.fault or f"accepted no data for {PATIENCE_S:g} s"
            return
        self._thread.join(PATIENCE_S)
        if self._thread.is_alive():
            self.fault = self.fault or f"did not end within {PATIENCE_S:g} s"

    def _work(self) -> None:
        try:
            stream = self._open()
            while (batches := self._queue.get()) is not None:
                for batch in batches:
                    batch.send(stream)
            stream.flush(timeout_sec=PATIENCE_S / 2)
            stream.disconnect()
        except Exception as fault:
            words = str(fault).splitlines() or [""]
            self.fault = f"{type(fault).__name__}: {words[0]}"
            while not self._queue.empty():  # so that `put` does not wait for room
                self._queue.get_nowait()


@dataclass(frozen=True, slots=True)
class Viewing:
    """What to record, and where: a file of the output folder, a viewer's address, both or neither."""

    file: bool = False
    address: str | None = None
    images: str = "all"
    """`all` images, those of `signs`, or `none`."""
    detail: bool = False
    """Also the label images of both passes of segmentation."""
    blur: bool = False
    """Blur what lies off the boxes of possible signs."""


class RerunObserver:
    """Turns items into entities in the thread that made them, and sends each frame's in one go, in order.

    Entities of the stages in the workers wait until the motion of their frame is known. Every row then has all
    timelines, also the distance along the road, and only one thread sets times. Faults go to the summary, not the run.
    """

    def __init__(
        self,
        recorders: Sequence[Recorder],
        location: GaussianModel,
        viewing: Viewing,
        plane: str | None,
    ) -> None:
        self._recorders = tuple(recorders)
        self._state = ViewState(viewing.images, viewing.detail, viewing.blur)
        self._lock = threading.Lock()
        self._waiting: dict[int, list[Entity]] = defaultdict(list)
        self._held_images: dict[int, list[Entity]] = {}
        self._times: dict[int, Times] = {}
        self._plane = plane
        self._planed: set[str] = set()
        self._fault: str | None = None
        self._guarded(lambda: self._send([opening(location)]))

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
        """Whether that file is incomplete."""
        failed = any(r.name == RECORDING and r.fault is not None for r in self._recorders)
        return self.records and (failed or self._fault is not None)

    def see(self, stage: str, item: Item) -> None:
        """Record the output of a stage for a frame."""
        self._guarded(lambda: self._see(stage, item.frame, item))

    def finish(self, inventory: WrittenTables) -> None:
        """Send what is known only at the end as it is made; nothing of it is left out."""
        for one in self._recorders:
            one.patience_s = PATIENCE_S
        self._guarded(lambda: self._send(closing(inventory, self._state, self._times)))

    def close(self) -> list[str]:
        """End all recordings; what went wrong with any, in words."""
        faults = [] if self._fault is None else [self._fault]
        for one in self._recorders:
            one.close()
            if one.fault is not None:
                faults.append(f"{one.name}: {one.fault}")
            elif one.dropped:
                faults.append(f"{one.name}: {one.dropped} frames left out, the viewer was too slow")
        return faults

    def _guarded(self, work: Callable[[], None]) -> None:
        if self._fault is not None:
            return
        try:
            work()
        except Exception as fault:
            self._fault = f"recording stopped after {type(fault).__name__}: {fault}"

    def _see(self, stage: str, frame: Frame, item: Item) -> None:
        found = entities_of(item, stage, self._state)
        if not isinstance(item, TrackedFrame):
            with self._lock:
                self._waiting[frame.index] += found
            if isinstance(item, PosedDetections):
                self._send_posed(frame, item)
        elif found:
            image = self._held_images.pop(frame.index, []) if stage == LAST_STAGE else []
            active = active_landmarks(self._state, frame.index) if image else []
            shown = image if any(landmark.verdict == "sign" for landmark in active) else []
            self._send([Batch(self._times[frame.index], (*shown, *found))])

    def _send_posed(self, frame: Frame, item: PosedDetections) -> None:
        with self._lock:
            found = self._waiting.pop(frame.index, [])
        station_m = None if item.motion is None else item.motion.station_m
        times = Times(frame.index, frame.time_ns, frame.log_time_ns, station_m)
        if item.motion is not None:
            self._times[frame.index] = times
        if self._state.images == "signs":
            self._held_images[frame.index] = [e for e in found if e.path == at.IMAGE]
            found = [e for e in found if e.path != at.IMAGE]
        self._send([Batch(times, tuple(found))])

    def _send(self, batches: Iterable[Batch]) -> None:
        for batch in batches:
            sent = [batch]
            if self._plane is not None:  # once for each layer of the image: the frame it lies in
                paths = {e.path for e in batch.entities if e.path.startswith(f"{at.CAMERA}/")}
                new = sorted(paths - self._planed)
                self._planed |= paths
                frame = rr.CoordinateFrame(self._plane)
                sent.insert(0, Batch(None, tuple(Entity(path, frame) for path in new)))
            for recorder in self._recorders:
                recorder.put(sent)


def open_observer(
    viewing: Viewing, folder: Path, log: str, location: GaussianModel, report: ReadReport
) -> RerunObserver:
    """Start the recordings of a run; `folder` exists, `log` is the name of the recording, `report` what reading chose.

    A recording without images is laid over those of the log: in the coordinate frame that Rerun's importer gives.
    """

    def stream(*, live: bool) -> rr.RecordingStream:
        made, layout = rr.RecordingStream(APPLICATION, recording_id=log), drive_layout(live=live)
        if live:
            made.connect_grpc(viewing.address, default_blueprint=layout)
        else:
            made.save(folder / RECORDING, default_blueprint=layout)
        return made

    recorders = []
    if viewing.file:
        recorders.append(Recorder(RECORDING, partial(stream, live=False), PATIENCE_S))
    if viewing.address is not None:
        recorders.append(Recorder(viewing.address, partial(stream, live=True), 0.0))
    plane = f"{report.camera_frame}_image_plane" if viewing.images == "none" else None
    return RerunObserver(recorders, location, viewing, plane)
