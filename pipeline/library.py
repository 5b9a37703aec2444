"""wayside as a library: what `import wayside` offers. Heavy imports stand inside, so that the import is quick."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, Protocol

from wayside.schemas.errors import UsageError

if TYPE_CHECKING:
    import pyarrow as pa

    from wayside.pipeline.reading.frames import ReadReport
    from wayside.pipeline.running.run import Run, RunObserver
    from wayside.schemas.landmarks import TrackedFrame
    from wayside.schemas.settings import Settings
    from wayside.schemas.tables import Table

PathLike = str | os.PathLike[str]


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is: frames that are finished, and the fraction (0 to 1) of the log's bytes that is read."""

    frames: int
    fraction: float


class Inventory:
    """The signs of one log as Arrow tables, of a finished run or of one that proceeds as it is asked for.

    Attributes are read at the first access and kept. Asking for a table carries the run to its end. Iterating yields
    each frame as soon as all its candidates are decided, with the landmarks first seen in it. A frame is given once:
    the iteration of a finished inventory is empty.

    `run` and `open_inventory` make them.
    """

    def __init__(self, frames: Iterator[TrackedFrame], result: _Result) -> None:
        self._frames, self._result = frames, result
        self._tables: dict[str, pa.Table] = {}
        self._fault: BaseException | None = None

    def __iter__(self) -> Iterator[TrackedFrame]:
        return self

    def __next__(self) -> TrackedFrame:
        if self._fault is not None:
            raise self._fault
        try:
            return next(self._frames)
        except StopIteration:
            raise
        except BaseException as fault:
            self._fault = fault
            raise

    def finish(self) -> Inventory:
        """Carry the run to its end, so that its tables exist; the inventory itself.

        Raises
        ------
        InputError
            The log cannot be used, or none of its images can.
        OutputError
            The output folder cannot be written.
        StageError
            A stage failed; its name and the frame are in the message.
        """
        for _ in self:
            pass
        return self

    @property
    def signs(self) -> pa.Table:
        """One row a physical panel, the columns of `signs.parquet` (docs/tables.md). Raises as `finish` does."""
        from wayside.schemas.tables import SIGNS

        return self._table(SIGNS)

    @property
    def observations(self) -> pa.Table:
        """One row a region of an image, the columns of `observations.parquet`. Raises as `finish` does."""
        from wayside.schemas.tables import OBSERVATIONS

        return self._table(OBSERVATIONS)

    @property
    def frames(self) -> pa.Table:
        """One row a frame of the log, the columns of `frames.parquet`. Raises as `finish` does."""
        from wayside.schemas.tables import FRAMES

        return self._table(FRAMES)

    @property
    def about(self) -> dict[str, Any]:
        """The content of `run.json`: versions, settings, notes, what was lost. Raises as `finish` does."""
        return self.finish()._result.about()

    def _table(self, table: Table) -> pa.Table:
        self.finish()
        if table.file not in self._tables:
            self._tables[table.file] = self._result.table(table)
        return self._tables[table.file]


def run(
    log: PathLike,
    *,
    preset: str = "default",
    settings: Settings | Mapping[str, Any] | None = None,
    spacing: str | float | None = None,
    calibration: PathLike | None = None,
    camera: str | None = None,
    workers: int | None = None,
    detector: PathLike | None = None,
    detections: PathLike | None = None,
    classes: PathLike | None = None,
    progress: Callable[[Progress], None] | None = None,
    out: PathLike | None = None,
    view: Literal["file", "live", "serve"] | None = None,
    overwrite: bool = False,
) -> Inventory:
    """Find the signs of a log.

    The log is processed as the inventory is asked for: iterate it, read one of its tables or call `finish`. Nothing
    of the process is changed: a program that does nothing else is faster with `cv2.setNumThreads(1)`, as the workers
    share the cores already.

    Parameters
    ----------
    log
        An MCAP file.
    preset
        `default` finds the most; `report` is the last chain of KS-09-9, `report-shape` and `report-2d` those before.
    settings
        Values by full name, such as `{"segment.clusters": 8}`, that replace those of the preset; or all settings,
        which leaves nothing to a preset.
    spacing
        Distance between images where the log has no poses: metres, or a text such as `"26.4ft"`.
    calibration
        YAML of ROS camera_info, OpenCV or Kalibr instead of the log's calibration.
    camera
        Image topic, where the log has several.
    workers
        Images processed side by side; the result does not depend on it.
    detector
        ONNX file of a YOLO or RT-DETR detector that takes the place of wayside's own (docs/detectors.md).
    detections
        Parquet or COCO JSON of boxes made elsewhere, instead of a detector.
    classes
        TOML: which classes of these are signs, and their colours and shapes.
    progress
        Called after each settled frame.
    out
        Folder for the tables and `run.json`, as `wayside run` writes them; None: the tables are kept in memory.
    view
        Record every step for the Rerun viewer: to `file` `drive.rrd` in the folder `out`, `live` to a window, or
        `serve` to the browser.
    overwrite
        Replace whatever stands in the folder `out` under the names of a result; else only a result of the same log.

    Raises
    ------
    UsageError
        A setting or option is unknown or out of range, or options exclude each other.
    InputError
        A model file, detector, file of boxes or calibration cannot be used. What is wrong with the log shows when it
        is read.
    """
    from wayside.pipeline.models.model_files import load_models

    if view == "file" and out is None:
        raise UsageError('view="file" needs a folder for the recording. Give out.')
    given: dict[str, Any] = {
        "read.spacing_m": spacing,
        "read.calibration": calibration,
        "read.camera": camera,
        "run.workers": workers,
        "models.detector": detector,
        "models.detections": detections,
        "models.classes": classes,
    }
    chosen = _settings(preset, settings, given)
    models = load_models(chosen)
    path = Path(log)
    address = _start_viewer(view)

    def process(folder: Path, under_way: Run) -> Iterator[TrackedFrame]:
        from wayside.pipeline.running.run import process_log

        def open_observer(report: ReadReport, part: Path) -> RunObserver | None:
            if view is None:
                return None
            from wayside.pipeline.view.observer import Viewing, open_observer

            viewing = Viewing(view == "file", address)
            return open_observer(viewing, part, path.stem, models.location_classes, report)

        frames = process_log(
            path,
            folder,
            chosen,
            models,
            under_way,
            arguments=[],
            open_observer=open_observer,
            overwrite=overwrite,
        )
        yield from _reported(frames, under_way, progress)

    if out is not None:
        from wayside.pipeline.running.run import Run

        return Inventory(process(Path(out), Run()), _ResultFolder(Path(out)))
    kept = _KeptResult()
    return Inventory(_kept(process, kept), kept)


def open_inventory(folder: PathLike) -> Inventory:
    """The inventory that a run left in a folder; its tables are read when they are asked for.

    Raises
    ------
    InputError
        The folder holds no result of a run.
    """
    from wayside.pipeline.results.result import read_run

    read_run(Path(folder))
    return Inventory(iter(()), _ResultFolder(Path(folder)))


class _Result(Protocol):
    """Where a finished run is read from."""

    def table(self, table: Table) -> pa.Table: ...

    def about(self) -> dict[str, Any]: ...


class _ResultFolder:
    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def table(self, table: Table) -> pa.Table:
        from wayside.pipeline.results.result import read_table

        return read_table(self._folder, table)

    def about(self) -> dict[str, Any]:
        from wayside.pipeline.results.result import read_run

        return read_run(self._folder)


class _KeptResult:
    def __init__(self) -> None:
        self._tables: dict[str, pa.Table] = {}
        self._about: dict[str, Any] = {}

    def keep(self, folder: Path) -> None:
        from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

        written = _ResultFolder(folder)
        self._tables = {table.file: written.table(table) for table in (SIGNS, OBSERVATIONS, FRAMES)}
        self._about = written.about()

    def table(self, table: Table) -> pa.Table:
        return self._tables[table.file]

    def about(self) -> dict[str, Any]:
        return self._about


def _kept(
    process: Callable[[Path, Run], Iterator[TrackedFrame]], kept: _KeptResult
) -> Iterator[TrackedFrame]:
    """Process in a scratch folder that goes with the last frame, when its tables are in memory."""
    from wayside.pipeline.running.run import Run

    with TemporaryDirectory(prefix="wayside-") as scratch:
        yield from process(Path(scratch), Run())
        kept.keep(Path(scratch))


def _reported(
    frames: Iterator[TrackedFrame],
    under_way: Run,
    progress: Callable[[Progress], None] | None,
) -> Iterator[TrackedFrame]:
    for count, settled in enumerate(frames, 1):
        if progress is not None:
            read = under_way.report
            progress(Progress(count, min(read.bytes_read / max(read.bytes_total, 1), 1.0)))
        yield settled


def _start_viewer(view: str | None) -> str | None:
    if view not in (None, "file", "live", "serve"):
        raise UsageError(f"view is {view!r}. Give file, live or serve.")
    if view in (None, "file"):
        return None
    from wayside.pipeline.view.viewer import start_viewer

    return start_viewer(serve=view == "serve")


def _settings(
    preset: str, settings: Settings | Mapping[str, Any] | None, options: Mapping[str, Any]
) -> Settings:
    """The settings of a run; options: by full name, None where not given, paths as such."""
    from wayside.pipeline.files.settings_file import load_settings, settings_values
    from wayside.schemas.settings import Settings

    if isinstance(settings, Settings):
        if preset != "default":
            raise UsageError(f"a preset ({preset}) and all settings are given. Give one.")
        groups = settings_values(settings)
        overrides = {
            f"{group}.{k}": v for group, leaves in groups.items() for k, v in leaves.items()
        }
    else:
        overrides = dict(settings or {})
    given = {
        name: os.fspath(value) if isinstance(value, os.PathLike) else value
        for name, value in options.items()
        if value is not None
    }
    return load_settings(preset, options=overrides | given)[0]
