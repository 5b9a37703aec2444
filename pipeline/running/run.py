"""The main job: one log in, one folder of tables out."""

import json
import os
import platform
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, Protocol

from wayside.pipeline.code_words import system_notes
from wayside.pipeline.files.output_folder import RECORDING, OutputFolder
from wayside.pipeline.files.route_file import open_routes, route_notes
from wayside.pipeline.files.settings_file import settings_digest
from wayside.pipeline.files.visible_text import counted, visible
from wayside.pipeline.files.writing import create, not_written
from wayside.pipeline.image_memory import ImageMemory
from wayside.pipeline.labels.box_accounting import BoxAccounting, paired
from wayside.pipeline.models.model_files import Models, learned_from
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.selection import describe_duplicates
from wayside.pipeline.results.inventory import InventoryWriter, WrittenTables
from wayside.pipeline.results.result import (
    RUN_FILE,
    EarlierResult,
    check_earlier,
    file_digest,
    log_fingerprint,
    mark_older,
    result_name,
)
from wayside.pipeline.running.flow import Drive, Flow, FrameCounts, Observer, paced
from wayside.pipeline.running.journal import Journal, journal_key, remove_journal, result_key
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
    Frame,
)
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.settings import Settings
from wayside.schemas.tables import ROADSIDE, SIGNS
from wayside.stages.calibration import DriveCalibration, describe_calibration
from wayside.stages.classifiers import providers
from wayside.stages.mapping import WINDOW_STEP
from wayside.stages.roadside import HELD_IMAGES


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


OpenObserver = Callable[[ReadReport, Path], RunObserver | None]
"""Makes the observer of a run, which sees every item of every stage, or none."""
Calibrate = Callable[[Path, Path, Settings], Settings]
"""Gives the settings with a calibration by the drive, whose file it leaves in the folder of the result."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run did, for the closing summary and `run.json`."""

    log: Path
    folder: Path
    inventory: WrittenTables
    report: ReadReport
    frames: dict[str, int]
    stage_seconds: dict[str, float]
    wall_seconds: float = 0.0
    view_faults: tuple[str, ...] = ()
    view_images: str | None = None
    recorded: bool | None = None
    """Whether the recording of every step is whole; None where none was asked for."""
    boxes: BoxAccounting | None = None
    replayed: int | None = None
    """Frames whose candidates came from the journal of a run before; None where none was kept."""
    lens: DriveCalibration | None = None
    image_bytes: int = 0
    """The most that images under way took, see `ImageMemory`."""
    older: tuple[str, ...] = ()
    """Files in the folder that are of the result before it."""

    @property
    def notes(self) -> list[str]:
        """Faults of the log that were corrected, or that matter for trusting the result, in words."""
        more = () if self.boxes is None else self.boxes.notes
        return [*self.report.notes, *self.inventory.path.notes, *more]

    @property
    def lost(self) -> list[str]:
        """Parts of the input that could not be used though they should have been, in words."""
        words = (
            (UNDECODABLE, "not decoded"),
            (DAMAGED, "damaged and decoded only in part"),
            (WRONG_SIZE, "of another size than the calibration"),
            (TURNED, "rotated by the Exif orientation, unlike the first"),
            (NO_CALIBRATION, "without calibration"),
        )
        images = [f"{counted(self.frames[s], 'image')} {w}" for s, w in words if self.frames.get(s)]
        return [*(str(problem) for problem in self.report.problems), *images]


@dataclass(slots=True)
class Run:
    """A run under way."""

    report: ReadReport = field(default_factory=ReadReport)
    """What reading came across so far."""
    result: RunResult | None = None
    """There once its files stand."""
    counts: FrameCounts = field(default_factory=FrameCounts)
    """Of the frames that are done so far."""


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What a run is asked for."""

    log: Path
    """The MCAP file."""
    folder: Path
    """Where the result goes; made where it is missing."""
    settings: Settings
    """What the stages work with."""
    models: Models
    """The same, learned."""
    arguments: Sequence[str] = ()
    """The command line, for `run.json`."""
    every_region: bool = False
    """List regions that no classifier looked at, or the colour gate refused, too."""
    open_observer: OpenObserver = lambda report, part: None
    """Called with what reading chose and the folder to write to, when the log can be read."""
    rate: float | None = None
    """Read at so many times the recorded speed; None: as fast as the work goes."""
    overwrite: bool = False
    """Replace whatever stands in the folder under the names of a result; else only a result of the same log."""
    resume: bool = False
    """Keep a `Journal`, and go on with that of an earlier run. Not with an observer, which would miss its frames."""
    calibrate: Calibrate | None = None
    """Called first; None: the calibration is that of the settings or of the log."""


def run_log(asked: RunRequest, run: Run | None = None) -> RunResult:
    """Process one log to its end. Raises as `process_log`."""
    run = run or Run()
    for _ in process_log(asked, run):
        pass
    assert run.result is not None
    return run.result


def process_log(asked: RunRequest, run: Run) -> Iterator[TrackedFrame]:
    """Process one log, frame by frame, and write its tables and `run.json` after the last one.

    A generator: nothing happens before the first frame is asked for. The files of the result replace those of an
    earlier one together, after the last frame; closed early, it changes nothing. `run` is filled meanwhile.

    Raises InputError where the log or all of its images cannot be used. Raises OutputError where the folder cannot be
    written, or holds something that is not replaced. Raises StageError, which names stage and frame, where one failed.
    """
    folder = asked.folder
    with OutputFolder(folder, kept=(RECORDING,)) as output, ExitStack() as ended:
        earlier = check_earlier(folder, asked.log, overwrite=asked.overwrite)
        digests, how = asked.models.digests(), {"every_region": asked.every_region}
        how |= {"self_calibrate": asked.calibrate is not None}
        key = result_key(asked.log, asked.settings, digests, **how)
        if asked.calibrate is not None:
            settings = asked.calibrate(asked.log, folder, asked.settings)
            asked = replace(asked, settings=settings)
        journal = None
        if asked.resume:
            journal = Journal(folder, journal_key(asked.log, asked.settings, asked.models))
            ended.callback(journal.close)
        result = yield from _Task(asked, run, output.part, earlier, journal).process()
        _write_run(result, asked, key, output.part)
        drop = [table.file for table in ROADSIDE] if result.inventory.sections is None else []
        output.commit([*drop, RECORDING] if earlier.recorded and not result.recorded else drop)
        new = result_name({"files": {SIGNS.file: {"sha256": file_digest(folder / SIGNS.file)}}})
        older = mark_older(folder) if earlier.result != new else []
        run.result = replace(result, older=tuple(older))
        remove_journal(folder)


@dataclass(slots=True)
class _Task:
    """One log that is processed; all but `run.json` is written into `part`."""

    asked: RunRequest
    run: Run
    part: Path
    earlier: EarlierResult
    journal: Journal | None
    clock: StageClock = field(default_factory=StageClock)
    statuses: Counter[str] = field(default_factory=Counter)
    duplicates: list[str] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)

    def process(self) -> Generator[TrackedFrame, None, RunResult]:
        """Yield every frame once it is done, then give the result."""
        asked, source = self.asked, self.asked.models.external
        routes, frames = open_routes(asked.settings.route), self._frames()
        name, settings = visible(asked.log.stem), asked.settings
        writer = InventoryWriter(self.part, name, every_region=asked.every_region)
        observer = asked.open_observer(self.run.report, self.part)
        accounting = None if source is None else BoxAccounting(source)
        window = settings.track.longest + WINDOW_STEP + HELD_IMAGES * settings.roadside.on
        memory = ImageMemory(settings.run.memory_mb, window)
        try:
            if observer is not None and observer.records:
                self.earlier.check_recording()
            counts, clock = self.run.counts, self.clock
            flow = Flow(
                settings, asked.models, clock, observer, self.journal, routes, memory, counts
            )
            for settled in flow.track(frames):
                self.statuses[settled.frame.status] += 1
                if settled.frame.status == DUPLICATE:
                    self.duplicates.append(settled.frame.label)
                writer.append(settled)
                if accounting is not None:
                    accounting.take(settled)
                yield settled
            if not self.statuses[USED]:
                raise InputError(_no_image(asked.log, self.statuses))
            if accounting is not None:
                accounting.require_known()
            drive = flow.finish()
            self.run.report.notes += self._notes(drive)
            inventory = writer.finish(drive.path, drive.signs, drive.sections)
        except BaseException:
            writer.discard()
            if observer is not None:
                observer.close()
            raise
        result = RunResult(
            asked.log,
            asked.folder,
            inventory,
            self.run.report,
            dict(self.statuses),
            self.clock.seconds(),
            boxes=accounting,
            replayed=None if self.journal is None else self.journal.replayed,
            lens=drive.lens,
            image_bytes=flow.memory.peak_bytes,
        )
        if observer is not None:
            result = self._closed(observer, result)
        return replace(result, wall_seconds=time.perf_counter() - self.started)

    def _frames(self) -> Iterator[Frame]:
        """The frames of the log; a log that cannot be used is refused at once, before a result is begun."""
        asked, report, source = self.asked, self.run.report, self.asked.models.external
        frames = read_frames(asked.log, asked.settings.read, report)
        if asked.rate is not None:
            frames = paced(frames, asked.rate)
        first = next(frames, None)
        if self.journal is not None and self.journal.note:
            report.notes.append(self.journal.note)
        if first is None:
            return iter(())
        if isinstance(source, BoxFile):
            report.notes += paired(source, first, report.images_held)
        return chain((first,), frames)

    def _notes(self, drive: Drive) -> list[str]:
        """What a person has to know of the drive."""
        on_globe, settings = drive.path.globe is not None, self.asked.settings
        routes = [sign.route for sign in drive.signs]
        notes = route_notes(settings.route, routes, on_globe=on_globe)
        if drive.lens is not None and drive.lens.refutes_given:
            told = describe_calibration(drive.lens, self.run.report.calibration_source)
            notes.append(f"{told}; --self-calibrate uses these values, but a board is better")
        notes += system_notes(drive.signs, settings.codes.settled)
        return notes + ([describe_duplicates(self.duplicates)] if self.duplicates else [])

    def _closed(self, observer: RunObserver, result: RunResult) -> RunResult:
        """The result with what its observer recorded and missed."""
        observer.finish(result.inventory)
        faults, lost = tuple(observer.close()), observer.recording_lost
        if lost:
            (self.part / RECORDING).unlink(missing_ok=True)
        recorded = not lost if observer.records else None
        return replace(result, view_faults=faults, view_images=observer.images, recorded=recorded)


def _no_image(log: Path, statuses: Counter[str]) -> str:
    reasons = ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))
    return (
        f"{log}: there are no images to process: {reasons or 'the log has none'}. See `wayside info` for what the "
        "log holds, and loosen --from, --until, --every or the calibration."
    )


def _write_run(result: RunResult, asked: RunRequest, key: str | None, part: Path) -> None:
    """`run.json`: everything needed to repeat the run, and all that differs between two runs of it."""
    settings, models, drive = asked.settings, asked.models, result.inventory
    content: dict[str, Any] = {
        "wayside": version("wayside"),
        "arguments": list(asked.arguments),
        "log": result.log.name,
        "log_path": str(result.log.absolute()),
        "log_fingerprint": log_fingerprint(result.log),
        "camera_topic": result.report.camera_topic,
        "view_images": result.view_images,
        "recording": RECORDING if result.recorded else None,
        "settings": asdict(settings),
        "settings_digest": settings_digest(settings),
        "models": models.digests(),
        "result_key": key,
        "learned_from_log": list(learned_from(result.log.stem, models.provenances())),
        "detector": None if result.boxes is None else result.boxes.source,
        "camera": drive.camera and asdict(drive.camera),
        "world": drive.path.world,
        "camera_height_m": drive.path.camera_height_m,
        "calibration": result.lens and result.lens.about,
        "us_probability": drive.signs[0].us_probability if drive.signs else None,
        "notes": result.notes,
        "accounting": {
            "frames_read": sum(result.frames.values()),
            "used": result.frames.get(USED, 0),
            "rejected": {k: v for k, v in sorted(result.frames.items()) if k != USED},
            "regions": drive.verdicts,
            "boxes": None if result.boxes is None else result.boxes.counts,
            "lost": result.lost,
        },
        "files": {
            name: {"rows": rows, "sha256": file_digest(part / name)}
            for name, rows in drive.rows.items()
        },
        "times": {
            "wall_s": round(result.wall_seconds, 3),
            "replayed_frames": result.replayed,
            "cpu_s_by_stage": {k: round(v, 3) for k, v in result.stage_seconds.items()},
        },
        "memory": {
            "limit_mb": settings.run.memory_mb or None,
            "images_at_most_mb": round(result.image_bytes / 1e6, 1),
        },
        "machine": {
            "system": platform.platform(),
            "python": platform.python_version(),
            "cores": os.cpu_count(),
            "networks": [] if settings.report.on else providers(),  # else it loads their engine
        },
    }
    try:
        with create(part / RUN_FILE) as stream:
            stream.write((json.dumps(content, indent=1) + "\n").encode())
    except OSError as error:
        raise not_written(part, error) from error
