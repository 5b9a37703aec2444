"""wayside as a library: what `import wayside` offers. Heavy imports stand inside, so that the import is quick."""

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

from wayside.schemas.errors import UsageError

if TYPE_CHECKING:
    import pyarrow as pa

    from wayside.pipeline.reading.frames import ReadReport
    from wayside.pipeline.running.run import RunObserver
    from wayside.schemas.landmarks import TrackedFrame
    from wayside.schemas.settings import Settings

PathLike = str | os.PathLike[str]
_PARTS = ("signs", "observations", "frames", "about")
_ROADSIDE = ("profile", "sections", "posts")


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

    def __init__(
        self, process: "Callable[[Path], Iterator[TrackedFrame]]", folder: Path | None
    ) -> None:
        self._read: dict[str, Any] = {}
        self._fault: BaseException | None = None
        self._folder = folder
        self._frames = self._in_memory(process) if folder is None else process(folder)

    def __iter__(self) -> "Iterator[TrackedFrame]":
        return self

    def __next__(self) -> "TrackedFrame":
        if self._fault is not None:
            raise self._fault
        try:
            return next(self._frames)
        except StopIteration:
            raise
        except BaseException as fault:
            self._fault = fault
            raise

    def finish(self) -> "Inventory":
        """Carry the run to its end, so that its tables exist; the inventory itself.

        Raises InputError where the log cannot be used, or none of its images can, and OutputError where the output
        folder cannot be written. Raises StageError where a stage failed; its name and the frame are in the message.
        """
        for _ in self:
            pass
        return self

    @property
    def signs(self) -> "pa.Table":
        """One row a physical panel, the columns of `signs.parquet` (docs/tables.md). Raises as `finish` does."""
        return self._table("signs")

    @property
    def observations(self) -> "pa.Table":
        """One row a region of an image, the columns of `observations.parquet`. Raises as `finish` does."""
        return self._table("observations")

    @property
    def frames(self) -> "pa.Table":
        """One row a frame of the log, the columns of `frames.parquet`. Raises as `finish` does."""
        return self._table("frames")

    @property
    def profile(self) -> "pa.Table":
        """The ground across the road, the columns of `profile.parquet`; with the setting `roadside.on` only."""
        return self._table("profile")

    @property
    def sections(self) -> "pa.Table":
        """Lines, edges and slopes by station and side, the columns of `sections.parquet`; as `profile`."""
        return self._table("sections")

    @property
    def posts(self) -> "pa.Table":
        """What each support stands on, the columns of `posts.parquet`; as `profile`."""
        return self._table("posts")

    @property
    def about(self) -> dict[str, Any]:
        """The content of `run.json`: versions, settings, notes, what was lost. Raises as `finish` does."""
        about: dict[str, Any] = self._part("about")
        return about

    def _repr_html_(self) -> str:
        """What a notebook shows: a map and a table of the signs. Raises as `finish` does."""
        from wayside.pipeline.evidence.gather import drive_map
        from wayside.pipeline.evidence.sheet import format_notebook

        signs, frames = self.signs.to_pylist(), self.frames.to_pylist()
        return format_notebook(str(self.about.get("log", "")), signs, drive_map(frames, signs))

    def to_geopandas(self) -> Any:
        """The signs as a `geopandas.GeoDataFrame`: points on WGS 84, without fixes x, y, z of the drive's own frame.

        Raises UsageError where geopandas is not installed, else as `finish` does.
        """
        try:
            import geopandas
        except ImportError as error:
            raise UsageError(
                "to_geopandas needs geopandas. Install it with pip install 'wayside[geopandas]'."
            ) from error
        frame = self.signs.drop_columns(["geometry"]).to_pandas()
        if frame["lon_deg"].isna().all():
            points = geopandas.points_from_xy(frame["x"], frame["y"], frame["z"])
            return geopandas.GeoDataFrame(frame, geometry=points)
        points = geopandas.GeoSeries.from_wkb(self.signs["geometry"].to_pandas(), crs="EPSG:4326")
        return geopandas.GeoDataFrame(frame, geometry=points)

    def evidence(
        self,
        folder: PathLike | None = None,
        *,
        units: Literal["metric", "us"] = "metric",
        **options: Any,
    ) -> Path:
        """Write a page a sign into a folder, None: `evidence` in that of the result; their index, or the only page.

        `wayside.pipeline.evidence.write.write_evidence` describes the other options and the errors raised.
        """
        from wayside.pipeline.evidence.marks import UNITS
        from wayside.pipeline.evidence.write import write_evidence

        out = self._result("evidence")
        target = out / "evidence" if folder is None else Path(folder)
        written = write_evidence(out, target, units=UNITS[units], **options)
        return written.index or written.sheets[0]

    def export(
        self,
        file: PathLike,
        kind: str | None = None,
        *,
        review: PathLike | None = None,
        **options: Any,
    ) -> Path:
        """Write the signs to a file for another program; the file.

        `kind`: a format such as `csv`; None: the ending of the file's name. `review`: None: the one in the result's
        folder. `wayside.pipeline.exporting.export.export` describes the other options and the errors raised.
        """
        from wayside.pipeline.exporting.export import FORMATS, export
        from wayside.pipeline.reviewing.review import find_review

        out, target = self._result("export"), Path(file)
        chosen = kind or target.suffix.lower().removeprefix(".")
        if chosen not in FORMATS:
            raise UsageError(f"{target}: the format is not one of {', '.join(FORMATS)}. Give kind.")
        said = find_review(out, () if review is None else [Path(review)])
        export(out, said, target, chosen, **options)
        return target

    def _result(self, name: str) -> Path:
        """The folder of the finished run."""
        self.finish()
        if self._folder is None:
            raise UsageError(f"{name} needs the result in a folder. Give `run` the folder out.")
        return self._folder

    def _table(self, name: str) -> "pa.Table":
        table: pa.Table = self._part(name)
        return table

    def _part(self, name: str) -> Any:
        self.finish()
        if name not in self._read:
            if self._folder is None:
                raise UsageError(f"the run has no {name}: give the setting roadside.on=True")
            self._read[name] = _read(self._folder, name)
        return self._read[name]

    def _in_memory(
        self, process: "Callable[[Path], Iterator[TrackedFrame]]"
    ) -> "Iterator[TrackedFrame]":
        """Process in a scratch folder that goes with the last frame, when its tables are in memory."""
        with TemporaryDirectory(prefix="wayside-") as scratch:
            yield from process(Path(scratch))
            more = (name for name in _ROADSIDE if (Path(scratch) / f"{name}.parquet").exists())
            self._read = {name: _read(Path(scratch), name) for name in (*_PARTS, *more)}


def run(  # noqa: PLR0913 - one for each option
    log: PathLike,
    *,
    preset: str = "default",
    settings: "Settings | Mapping[str, Any] | None" = None,
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

    Raises UsageError where a setting or option is unknown or out of range, or options exclude each other. Raises
    InputError where a model file, detector, file of boxes or calibration cannot be used. What is wrong with the log
    shows when it is read.
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

    def open_observer(report: "ReadReport", part: Path) -> "RunObserver | None":
        if view is None:
            return None
        from wayside.pipeline.view.observer import Viewing, open_observer

        viewing = Viewing(view == "file", address)
        return open_observer(viewing, part, path.stem, models.location_classes, report)

    def process(folder: Path) -> "Iterator[TrackedFrame]":
        from wayside.pipeline.running.run import Run, RunRequest, process_log

        asked = RunRequest(
            path, folder, chosen, models, open_observer=open_observer, overwrite=overwrite
        )
        under_way = Run()
        for count, settled in enumerate(process_log(asked, under_way), 1):
            if progress is not None:
                read = under_way.report
                progress(Progress(count, min(read.bytes_read / max(read.bytes_total, 1), 1.0)))
            yield settled

    return Inventory(process, None if out is None else Path(out))


def open_inventory(folder: PathLike) -> Inventory:
    """The inventory that a run left in a folder; its tables are read when they are asked for.

    Raises InputError where the folder holds no result of a run.
    """
    _read(Path(folder), "about")
    return Inventory(lambda folder: iter(()), Path(folder))


def _read(folder: Path, part: str) -> Any:
    """A part of a finished run."""
    from wayside.pipeline.results.result import read_run, read_table
    from wayside.schemas.tables import TABLES

    tables = {table.name: table for table in TABLES}
    return read_run(folder) if part == "about" else read_table(folder, tables[part])


def _start_viewer(view: str | None) -> str | None:
    if view not in (None, "file", "live", "serve"):
        raise UsageError(f"view is {view!r}. Give file, live or serve.")
    if view in (None, "file"):
        return None
    from wayside.pipeline.view.viewer import start_viewer

    return start_viewer(serve=view == "serve")


def _settings(
    preset: str, settings: "Settings | Mapping[str, Any] | None", options: Mapping[str, Any]
) -> "Settings":
    """The settings of a run; options: by full name, None where not given, paths as such."""
    from wayside.pipeline.files.settings_file import by_full_name, load_settings
    from wayside.schemas.settings import Settings

    if isinstance(settings, Settings):
        if preset != "default":
            raise UsageError(f"a preset ({preset}) and all settings are given. Give one.")
        overrides = by_full_name(settings)
    else:
        overrides = dict(settings or {})
    for name, value in options.items():
        if value is not None:
            overrides[name] = os.fspath(value) if isinstance(value, os.PathLike) else value
    return load_settings(preset, options=overrides)[0]
