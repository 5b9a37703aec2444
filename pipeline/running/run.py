"""The main job: one log in, one folder of tables out."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Protocol

from wayside.pipeline.code_words import system_notes
from wayside.pipeline.files.output_folder import RECORDING, OutputFolder
from wayside.pipeline.files.route_file import RouteFile, open_routes, route_notes
from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.labels.box_accounting import BoxAccounting, paired
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.selection import describe_duplicates
from wayside.pipeline.results.earlier_result import check_earlier
from wayside.pipeline.results.inventory import InventoryWriter, WrittenTables
from wayside.pipeline.running.flow import Drive, Flow, FrameCounts, Observer
from wayside.pipeline.running.image_memory import image_memory
from wayside.pipeline.running.journal import Journal, journal_key, remove_journal
from wayside.pipeline.running.pace import paced
from wayside.pipeline.running.run_file import write_run
from wayside.pipeline.workers import StageClock
from wayside.schemas.detectors import BoxFile
from wayside.schemas.errors import InputError
from wayside.schemas.frame import (
    DAMAGED,
    DUPLICATE,
    NO_CALIBRATION,
    TURNED,
    UNDECODABLE,
    USED,
    WRONG_SIZE,
    Camera,
    Frame,
)
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.settings import Settings
from wayside.stages.calibration import LensCheck

OpenObserver = Callable[[ReadReport, Path], "RunObserver | None"]
"""Makes the observer of a run, from what reading chose and the folder for its files."""


class RunObserver(Observer, Protocol):
    """Sees a run from the first frame to the inventory; its own faults are words, never exceptions."""

    @property
    def images(self) -> str:
        """Which images it records: `all`, those with `signs`, `none`."""

    @property
    def records(self) -> bool:
        """Whether it writes a recording next to the tables."""

    @property
    def recording_lost(self) -> bool:
        """Whether that recording could not be written."""

    def finish(self, inventory: WrittenTables) -> None:
        """Take note of what only the end tells."""

    def close(self) -> list[str]:
        """Write what waits; what went wrong."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run did, for the closing summary and `run.json`."""

    log: Path
    folder: Path
    inventory: WrittenTables
    report: ReadReport
    frames: dict[str, int]
    stage_seconds: dict[str, float]
    wall_seconds: float
    view_faults: tuple[str, ...] = ()
    view_images: str | None = None
    recorded: bool | None = None
    """Whether the recording of every step is whole; None where none was asked for."""
    boxes: BoxAccounting | None = None
    replayed: int | None = None
    """Frames whose candidates came from the journal of a run before; None where none was kept."""
    lens: LensCheck = field(default_factory=lambda: LensCheck(None, None, None))
    image_bytes: int = 0
    """The most that images under way took, see `ImageMemory`."""

    @property
    def notes(self) -> list[str]:
        """Faults of the log that were corrected, or that matter for trusting the result, in words."""
        more = () if self.boxes is None else self.boxes.notes
        return [*self.report.notes, *self.inventory.path.notes, *more]

    @property
    def lost(self) -> list[str]:
        """Parts of the input that could not be used though they should have been, in words."""
        words = (
            (UNDECODABLE, "do not decode"),
            (DAMAGED, "are damaged: they decode in part only"),
            (WRONG_SIZE, "have another size than the calibration of their time"),
            (TURNED, "are to be shown turned by their Exif orientation, unlike the first"),
            (NO_CALIBRATION, "have no calibration"),
        )
        images = [f"{self.frames[s]} images {w}" for s, w in words if self.frames.get(s)]
        return [*(str(problem) for problem in self.report.problems), *images]


def run_log(
    log: Path,
    folder: Path,
    settings: Settings,
    models: Models,
    run: Run | None = None,
    *,
    arguments: list[str],
    every_region: bool = False,
    open_observer: OpenObserver = lambda report, part: None,
    rate: float | None = None,
    overwrite: bool = False,
    resume: bool = False,
) -> RunResult:
    """Process one log to its end, as `process_log` does.

    Parameters
    ----------
    log, folder, settings, models, run, arguments, every_region, open_observer, rate, overwrite,
    resume
        As in `process_log`.

    Raises
    ------
    InputError, OutputError, StageError
        As in `process_log`.
    """
    run = run or Run()
    for _ in process_log(
        log,
        folder,
        settings,
        models,
        run,
        arguments=arguments,
        every_region=every_region,
        open_observer=open_observer,
        rate=rate,
        overwrite=overwrite,
        resume=resume,
    ):
        pass
    assert run.result is not None
    return run.result


@dataclass(slots=True)
class Run:
    """A run under way: what reading came across and how many frames are done so far, the result once it is complete.

    committed: its files stand.
    """

    report: ReadReport = field(default_factory=ReadReport)
    result: RunResult | None = None
    committed: bool = False
    counts: FrameCounts = field(default_factory=FrameCounts)


def process_log(
    log: Path,
    folder: Path,
    settings: Settings,
    models: Models,
    run: Run,
    *,
    arguments: list[str],
    every_region: bool = False,
    open_observer: OpenObserver = lambda report, part: None,
    rate: float | None = None,
    overwrite: bool = False,
    resume: bool = False,
) -> Iterator[TrackedFrame]:
    """Process one log, frame by frame, and write its tables and `run.json` into `folder` after the last one.

    A generator: nothing happens before the first frame is asked for. The files of the result replace those of an
    earlier one together, after the last frame; closed early, it changes nothing.

    Parameters
    ----------
    log, folder
        The MCAP file; the output folder, made where it is missing.
    settings, models
        What the stages work with.
    run
        Filled while the generator runs; its `result` is there after the last frame.
    arguments
        The command line, for `run.json`.
    every_region
        List regions that no classifier looked at, or the colour gate refused, too.
    open_observer
        Called with what reading chose and the folder to write to, when the log can be read; what it gives sees every
        item of every stage.
    rate
        Read at so many times the recorded speed; None: as fast as the work goes.
    overwrite
        Replace whatever stands in the folder under the names of a result; else only a result of the same log.
    resume
        Keep a journal of what was found in each image, and go on with that of a run before; see `Journal`. Not with an
        observer, which would see nothing of the frames in it.

    Raises
    ------
    InputError
        The log cannot be used, or none of its images can.
    OutputError
        The folder cannot be written, or something stands there that is not replaced.
    StageError
        A stage failed; its name and the frame are in the message.
    """
    with OutputFolder(folder, kept=(RECORDING,)) as output:
        earlier = check_earlier(folder, log, overwrite=overwrite)

        def observe(report: ReadReport) -> RunObserver | None:
            observer = open_observer(report, output.part)
            if observer is not None and observer.records:
                earlier.check_recording()
            return observer

        journal = Journal(folder, journal_key(log, settings, models)) if resume else None
        with nullcontext() if journal is None else closing(journal):
            task = _Task(log, output.part, settings, models, run, journal, rate)
            yield from task.process(observe, every_region=every_region)
        assert run.result is not None
        write_run(run.result, output.part, settings, models, arguments, every_region=every_region)
        output.commit([RECORDING] if earlier.recorded and not run.result.recorded else [])
        run.committed = True
        remove_journal(folder)


@dataclass(slots=True)
class _Task:
    """One log that is processed; all but `run.json` is written into `part`."""

    log: Path
    part: Path
    settings: Settings
    models: Models
    run: Run
    journal: Journal | None
    rate: float | None
    clock: StageClock = field(default_factory=StageClock)
    statuses: Counter[str] = field(default_factory=Counter)
    duplicates: list[str] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)

    def process(
        self, open_observer: Callable[[ReadReport], RunObserver | None], *, every_region: bool
    ) -> Iterator[TrackedFrame]:
        """Yield every frame once it is done; then the run has its result."""
        routes, frames = open_routes(self.settings.route), self._frames()
        writer = InventoryWriter(self.part, visible(self.log.stem), every_region=every_region)
        observer = open_observer(self.run.report)
        source = self.models.external
        accounting = None if source is None else BoxAccounting(source)
        try:
            flow = self._flow(observer, routes)
            for settled in flow.track(frames):
                self._count(settled)
                writer.append(settled)
                if accounting is not None:
                    accounting.take(settled)
                yield settled
            if not self.statuses[USED]:
                raise InputError(_no_image(self.log, self.statuses))
            if accounting is not None:
                accounting.require_known()
            drive = flow.finish()
            self.run.report.notes += self._notes(drive)
            inventory = writer.finish(drive.path, drive.signs)
        except BaseException:
            writer.discard()
            if observer is not None:
                observer.close()
            raise
        self.run.result = RunResult(
            self.log,
            self.part.parent,
            inventory,
            self.run.report,
            dict(self.statuses),
            self.clock.seconds(),
            *self._closed(observer, inventory),
            boxes=accounting,
            replayed=None if self.journal is None else self.journal.replayed,
            lens=drive.lens,
            image_bytes=flow.memory.peak_bytes,
        )

    def _frames(self) -> Iterator[Frame]:
        """The frames of the log; a log that cannot be used is refused at once, before a result is begun."""
        report, source = self.run.report, self.models.external
        frames = read_frames(self.log, self.settings.read, report)
        if self.rate is not None:
            frames = paced(frames, self.rate)
        first = next(frames, None)
        if self.journal is not None and self.journal.note:
            report.notes.append(self.journal.note)
        if first is None:
            return iter(())
        if isinstance(source, BoxFile):
            report.notes += paired(source, first, report.images_held)
        return chain((first,), frames)

    def _flow(self, observer: RunObserver | None, routes: RouteFile | None) -> Flow:
        return Flow(
            self.settings,
            self.models,
            self.clock,
            observer,
            self.journal,
            routes,
            image_memory(self.settings),
            self.run.counts,
        )

    def _count(self, settled: TrackedFrame) -> None:
        self.statuses[settled.frame.status] += 1
        if settled.frame.status == DUPLICATE:
            self.duplicates.append(settled.frame.label)

    def _notes(self, drive: Drive) -> list[str]:
        """What a person has to know of the drive."""
        on_globe, found = drive.path.globe is not None, drive.lens.found
        notes = route_notes(self.settings.route, drive.signs, on_globe=on_globe)
        if found is not None:
            notes.append(_wrong_calibration(self.log, self.run.report, found))
        notes += system_notes(drive.signs, self.settings.codes.settled)
        return notes + ([describe_duplicates(self.duplicates)] if self.duplicates else [])

    def _closed(
        self, observer: RunObserver | None, inventory: WrittenTables
    ) -> tuple[float, tuple[str, ...], str | None, bool | None]:
        """Seconds of the run, faults of its observer, the images that it records, whether the recording is whole."""
        faults: list[str] = []
        recorded: bool | None = None
        if observer is not None:
            observer.finish(inventory)
            faults = observer.close()
            if observer.records:
                recorded = not observer.recording_lost
                if observer.recording_lost:
                    (self.part / RECORDING).unlink(missing_ok=True)
        wall = time.perf_counter() - self.started
        return wall, tuple(faults), None if observer is None else observer.images, recorded


def _wrong_calibration(log: Path, report: ReadReport, found: Camera) -> str:
    k1, k2 = found.distortion[:2]
    return (
        f"the calibration ({report.calibration_source}) cannot be right, and positions are wrong with it: the motion "
        f"in the images asks for a focal length of about {found.fx:.0f} px, k1 {k1:.2f}, k2 {k2:.2f}; "
        f"see `wayside calibrate {log}`"
    )


def _no_image(log: Path, statuses: Counter[str]) -> str:
    reasons = (
        ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))
        or "the log has none"
    )
    return (
        f"{log}: there are no images to process: {reasons}. See `wayside info` for what the log holds, and loosen "
        "--from, --until, --every or the calibration."
    )
