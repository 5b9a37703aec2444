"""Writes the tables of a result, in memory that grows with the signs and not with the images."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from wayside.pipeline.files.parquet import (
    choice,
    fixed_list,
    geoparquet_metadata,
    known,
    parquet_file,
    record_batch,
)
from wayside.pipeline.files.writing import create, not_written
from wayside.pipeline.results.rows import (
    date_us,
    frame_row,
    place_rows,
    posts_rows,
    roadside_rows,
    sign_id,
    sign_row,
)
from wayside.schemas.detections import VERDICTS
from wayside.schemas.frame import DUPLICATE, USED, Camera
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.roadside import CrossSection
from wayside.schemas.signs import Sign
from wayside.schemas.tables import FRAMES, OBSERVATIONS, POSTS, SIGNS, Table
from wayside.stages.georeference import DrivePath

_BATCH_ROWS = 4096
_UNLISTED = tuple(VERDICTS.index(name) for name in ("size", "color"))


@dataclass(frozen=True, slots=True)
class WrittenTables:
    """What was written."""

    log: str
    """Stem of the log's file name."""
    signs: tuple[Sign, ...]
    """In the order of the file."""
    path: DrivePath
    """On which they stand."""
    rows: dict[str, int]
    """Number of rows, by file."""
    verdicts: dict[str, int]
    """Number of regions, by verdict."""
    camera: Camera | None = None
    """Calibration of the first used image."""
    sections: tuple[CrossSection, ...] | None = None
    """Of the road. None: not asked for."""

    @property
    def sign_rows(self) -> list[dict[str, Any]]:
        """The rows of `signs.parquet`."""
        return [sign_row(sign, self.log) for sign in self.signs]


class InventoryWriter:
    """Takes tracked frames one by one; `finish` takes the signs and leaves the Parquet files.

    Observations wait in a scratch file of the folder, because the number of a sign is known only when all signs are.
    `log` is the stem of the log's file name, the first part of every sign's name. `every_region` also lists regions
    that no classifier saw, or the colour gate refused. Raises OutputError where the folder cannot be written.
    """

    def __init__(self, folder: Path, log: str, *, every_region: bool = False) -> None:
        self._folder, self._log, self._every_region = folder, log, every_region
        self._verdicts: Counter[str] = Counter()
        self._frames: dict[str, list[Any]] = {name: [] for name in FRAMES.schema.names}
        self._camera: Camera | None = None
        self._scratch_path = folder / ".observations.scratch"
        self._observation_count = 0
        try:
            self._scratch = create(self._scratch_path)
        except OSError as error:
            raise not_written(folder, error) from error
        self._stream = pa.ipc.new_stream(self._scratch, OBSERVATIONS.schema)

    def append(self, settled: TrackedFrame) -> None:
        """Take one frame with its candidates."""
        for name, value in frame_row(settled).items():
            self._frames[name].append(value)
        if self._camera is None and settled.frame.status == USED:
            self._camera = settled.frame.camera
        for reason, count in settled.dropped._asdict().items():
            if count:
                self._verdicts[reason] += count
        batch = self._observations(settled)
        if batch.num_rows:
            try:
                self._stream.write_batch(batch)
            except OSError as error:
                raise not_written(self._folder, error) from error

    def finish(
        self,
        path: DrivePath,
        signs: Sequence[Sign],
        sections: Sequence[CrossSection] | None = None,
    ) -> WrittenTables:
        """Write the tables; those of the roadside where there are cross-sections."""
        try:
            self._stream.close()
            self._scratch.close()
            tables = {SIGNS: [sign_row(sign, self._log) for sign in signs]}
            if sections is not None:
                tables |= roadside_rows(sections, path) | {POSTS: posts_rows(signs, self._log)}
            for table, found in tables.items():
                placed = table is SIGNS and path.globe is not None
                columns = {name: [row[name] for row in found] for name in table.schema.names}
                self._write(table, columns, geoparquet_metadata(found) if placed else None)
            self._write_frames(path)
            self._write_observations(signs)
        except OSError as error:
            raise not_written(self._folder, error) from error
        finally:
            self.discard()
        rows = {
            SIGNS.file: len(signs),
            OBSERVATIONS.file: self._observation_count,
            FRAMES.file: len(self._frames["frame"]),
            **{table.file: len(found) for table, found in tables.items()},
        }
        return WrittenTables(
            self._log,
            tuple(signs),
            path,
            rows,
            dict(sorted(self._verdicts.items())),
            self._camera,
            None if sections is None else tuple(sections),
        )

    def discard(self) -> None:
        """Remove the scratch file, then close it: what waits in its buffers may not fit on the disk."""
        with suppress(OSError):
            self._scratch_path.unlink(missing_ok=True)
        for part in (self._stream, self._scratch):
            with suppress(OSError, ValueError):  # ValueError: closed before
                part.close()

    def _observations(self, settled: TrackedFrame) -> pa.RecordBatch:
        table = settled.candidates
        for code, count in zip(*np.unique(table.verdict, return_counts=True), strict=True):
            self._verdicts[VERDICTS[code]] += int(count)
        listed = (
            np.ones(len(table), bool) if self._every_region else ~np.isin(table.verdict, _UNLISTED)
        )
        rows = np.flatnonzero(listed)
        regions = table.regions.select(rows)
        first = self._observation_count
        self._observation_count += len(rows)
        track = settled.track_id[rows]
        values: dict[str, Any] = {
            "frame": np.full(len(rows), settled.frame.index, np.int32),
            "date": [date_us(settled.frame.time_ns)] * len(rows),
            "observation_id": np.arange(first, first + len(rows)),
            "source": choice(OBSERVATIONS, "source", regions.source),
            "box": fixed_list(regions.box, 4),
            "area_px": regions.area_px,
            "u_px": table.center[rows, 0],
            "v_px": table.center[rows, 1],
            "u_ideal_px": table.ideal[rows, 0],
            "v_ideal_px": table.ideal[rows, 1],
            "red": regions.rgb[:, 0],
            "green": regions.rgb[:, 1],
            "blue": regions.rgb[:, 2],
            "color": choice(OBSERVATIONS, "color", table.color[rows]),
            "color_distance": known(table.color_distance[rows]),
            "shape": choice(OBSERVATIONS, "shape", table.shape[rows]),
            "shape_distance": known(table.shape_distance[rows]),
            "track_id": pa.array(track.astype(np.int32), mask=track < 0),
            "sign_id": pa.nulls(len(rows), pa.string()),
            "verdict": choice(OBSERVATIONS, "verdict", table.verdict[rows]),
            "residual_px": known(settled.residual_px[rows].astype(np.float32)),
            "score": known(table.score[rows]),
        }
        return record_batch(OBSERVATIONS, values)

    def _write_observations(self, signs: Sequence[Sign]) -> None:
        names: dict[Any, str] = {s.landmark.track_id: sign_id(s, self._log) for s in signs}
        at = OBSERVATIONS.schema.get_field_index("sign_id")
        tracks = OBSERVATIONS.schema.get_field_index("track_id")
        with (
            parquet_file(self._folder / OBSERVATIONS.file, OBSERVATIONS.schema) as sink,
            self._scratch_path.open("rb") as scratch,
        ):
            waiting: list[pa.RecordBatch] = []
            for batch in pa.ipc.open_stream(scratch):
                followed = batch.column(tracks).to_pylist()
                named = pa.array([names.get(track) for track in followed], pa.string())
                waiting.append(batch.set_column(at, OBSERVATIONS.schema.field(at), named))
                if sum(b.num_rows for b in waiting) >= _BATCH_ROWS:
                    sink.write_table(pa.Table.from_batches(waiting, OBSERVATIONS.schema))
                    waiting = []
            sink.write_table(pa.Table.from_batches(waiting, OBSERVATIONS.schema))

    def _write_frames(self, path: DrivePath) -> None:
        columns = self._frames
        for row, place in enumerate(place_rows(path, columns["frame"])):
            for name, value in place.items():
                columns[name][row] = value
            if columns["status"][row] == DUPLICATE:
                columns["baseline_m"][row] = 0.0
        self._write(FRAMES, columns)

    def _write(self, table: Table, columns: dict[str, Any], geo: str | None = None) -> None:
        with parquet_file(self._folder / table.file, table.schema, geo) as sink:
            sink.write_batch(record_batch(table, columns))
