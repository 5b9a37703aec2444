"""The main job: one log in, one folder of tables out."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from wayside.pipeline.flow import Flow, Observer
from wayside.pipeline.inventory import InventoryWriter, WrittenTables
from wayside.pipeline.model_files import Models
from wayside.pipeline.pace import paced
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.settings_file import settings_digest
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.frame import UNDECODABLE, USED, Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.settings import Settings
from wayside.stages.calibration import FocalCheck

RECORDING = "drive.rrd"
"""The recording of every step, beside the tables where it is asked for."""

Watcher = Callable[[TrackedFrame, ReadReport], None]


class RunObserver(Observer, Protocol):
    """Sees a run from the first frame to the inventory; its own faults are words, never exceptions."""

    @property
    def images(self) -> str:
        """Which images it records: `all`, those with `signs`, `none`."""

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
    focal: FocalCheck = field(default_factory=lambda: FocalCheck(None, None, None))

    @property
    def notes(self) -> list[str]:
        """What was found amiss in the log and made good, or has to be known to trust the result; in words."""
        return [*self.report.notes, *self.inventory.path.notes]

    @property
    def lost(self) -> list[str]:
        """Parts of the input that could not be used though they should have been, in words."""
        undecodable = self.frames.get(UNDECODABLE, 0)
        images = [f"{undecodable} images do not decode"] if undecodable else []
        return [*(str(problem) for problem in self.report.problems), *images]


def run_log(
    log: Path,
    folder: Path,
    settings: Settings,
    models: Models,
    *,
    arguments: list[str],
    every_region: bool = False,
    watch: Watcher = lambda settled, report: None,
    open_observer: Callable[[ReadReport], RunObserver | None] = lambda report: None,
    rate: float | None = None,
) -> RunResult:
    """Process one log to its end, as `process_log` does.

    Parameters
    ----------
    log, folder, settings, models, arguments, every_region, open_observer, rate
        As in `process_log`.
    watch
        Called with every settled frame on its way to the tables.

    Raises
    ------
    InputError, OutputError, StageError
        As in `process_log`.
    """
    run = Run()
    for settled in process_log(
        log,
        folder,
        settings,
        models,
        run,
        arguments=arguments,
        every_region=every_region,
        open_observer=open_observer,
        rate=rate,
    ):
        watch(settled, run.report)
    assert run.result is not None
    return run.result


@dataclass(slots=True)
class Run:
    """A run under way: what reading came across so far, and the result once it is complete."""

    report: ReadReport = field(default_factory=ReadReport)
    result: RunResult | None = None


def process_log(
    log: Path,
    folder: Path,
    settings: Settings,
    models: Models,
    run: Run,
    *,
    arguments: list[str],
    every_region: bool = False,
    open_observer: Callable[[ReadReport], RunObserver | None] = lambda report: None,
    rate: float | None = None,
) -> Iterator[TrackedFrame]:
    """Process one log, frame by frame, and write its tables and `run.json` into `folder` after the last one.

    A generator: nothing happens before the first frame is asked for; closed early, it leaves no table.

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
        List regions that the colour gate refused, too.
    open_observer
        Called with what reading chose, when the folder is there and the log can be read; what it gives sees every
        item of every stage.
    rate
        Read at so many times the recorded speed; None: as fast as the work goes.

    Raises
    ------
    InputError
        The log cannot be used, or none of its images can.
    OutputError
        The folder cannot be written.
    StageError
        A stage failed; its name and the frame are in the message.
    """
    started = time.perf_counter()
    _make_folder(folder)
    (folder / RECORDING).unlink(missing_ok=True)  # that of an earlier run would tell of other signs
    report, clock = run.report, StageClock()
    frames = read_frames(log, settings.read, report)
    if rate is not None:
        frames = paced(frames, rate)
    first = next(frames, None)  # a log that cannot be used leaves no half-made result behind
    observer = open_observer(report)
    flow = Flow(settings, models, clock, observer)
    writer = InventoryWriter(folder, log.stem, every_region=every_region)
    statuses: Counter[str] = Counter()
    try:
        for settled in flow.track(_with_first(first, frames)):
            statuses[settled.frame.status] += 1
            writer.append(settled)
            yield settled
        if not statuses[USED]:
            raise InputError(_no_image(log, statuses))
        path = flow.georeference()
        signs = tuple(flow.signs(path))
        focal = flow.check_calibration()
        if focal.error is not None:
            report.notes.append(_wrong_calibration(log, report, focal.error))
    except BaseException:
        writer.discard()
        if observer is not None:
            observer.close()
        raise
    inventory = writer.finish(path, signs)
    faults: list[str] = []
    if observer is not None:
        observer.finish(inventory)
        faults = observer.close()
    wall = time.perf_counter() - started
    run.result = RunResult(
        log,
        folder,
        inventory,
        report,
        dict(statuses),
        clock.seconds(),
        wall,
        tuple(faults),
        None if observer is None else observer.images,
        focal,
    )
    _write_run(run.result, settings, models, arguments)


def _with_first(first: Frame | None, rest: Iterator[Frame]) -> Iterator[Frame]:
    if first is not None:
        yield first
        yield from rest


def _wrong_calibration(log: Path, report: ReadReport, error: float) -> str:
    return (
        f"the calibration ({report.calibration_source}) cannot be right: its focal length is about "
        f"{100 * abs(error):.0f} % too {'long' if error > 0 else 'short'} for the motion in the images, and positions "
        f"along the road with it; see `wayside calibrate {log}`"
    )


def _no_image(log: Path, statuses: Counter[str]) -> str:
    reasons = (
        ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))
        or "none at all"
    )
    return (
        f"{log}: wanted images to process, found {reasons}; "
        "see `wayside info` for what the log holds and loosen --from, --until, --every or the calibration"
    )


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".wayside-probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(
            f"{folder}: wanted a folder to write the result to, found: {error.strerror or error}; "
            "choose another with -o"
        ) from error


def _write_run(result: RunResult, settings: Settings, models: Models, arguments: list[str]) -> None:
    """`run.json`: everything needed to repeat the run, and all that differs between two runs of it."""
    used = result.frames.get(USED, 0)
    rejected = {k: v for k, v in sorted(result.frames.items()) if k != USED}
    content: dict[str, Any] = {
        "wayside": version("wayside"),
        "arguments": arguments,
        "log": result.log.name,
        "log_path": str(result.log.absolute()),
        "camera_topic": result.report.camera_topic,
        "view_images": result.view_images,
        "settings": asdict(settings),
        "settings_digest": settings_digest(settings),
        "models": models.digests(),
        "world": result.inventory.path.world,
        "camera_height_m": result.inventory.path.camera_height_m,
        "focal_length": {"correction": result.focal.correction, "sigma": result.focal.sigma},
        "notes": result.notes,
        "accounting": {
            "frames_read": sum(result.frames.values()),
            "used": used,
            "rejected": rejected,
            "regions": result.inventory.verdicts,
            "lost": result.lost,
        },
        "files": {
            name: {"rows": rows, "sha256": _sha256(result.folder / name)}
            for name, rows in result.inventory.rows.items()
        },
        "times": {
            "wall_s": round(result.wall_seconds, 3),
            "cpu_s_by_stage": {k: round(v, 3) for k, v in result.stage_seconds.items()},
        },
        "machine": {
            "system": platform.platform(),
            "python": platform.python_version(),
            "cores": os.cpu_count(),
        },
    }
    path = result.folder / "run.json"
    try:
        part = path.with_suffix(".json.part")
        part.write_text(json.dumps(content, indent=1) + "\n")
        os.replace(part, path)
    except OSError as error:
        raise OutputError(
            f"{path}: could not be written: {error.strerror or error}; free some space"
        ) from error


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
