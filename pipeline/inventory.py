"""Writes the three tables of a result, in memory that grows with the signs and not with the pictures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from wayside.pipeline.parquet import (
    ParquetFile,
    choice,
    fixed_list,
    geoparquet_metadata,
    known,
    record_batch,
)
from wayside.pipeline.rows import FRAME_COLUMNS, SignRows, frame_row, pose_numbers, stretched_frames
from wayside.pipeline.world import PathPoint, World, place_in_world
from wayside.schemas.detections import VERDICTS
from wayside.schemas.errors import OutputError
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

_BATCH_ROWS = 4096
_UNLISTED = tuple(VERDICTS.index(name) for name in ("size", "color", "glance"))


@dataclass(frozen=True, slots=True)
class Inventory:
    """What was written: sign rows in the order of the file and their places, counts, the world they stand in."""

    signs: list[dict[str, Any]]
    places: list[Landmark]
    rows: dict[str, int]
    verdicts: dict[str, int]
    world: World
    camera_height_m: float | None


class InventoryWriter:
    """Takes settled frames one by one; `finish` numbers the signs and leaves the Parquet files.

    Observations wait in a scratch file of the output folder, because the number of a sign is known only when all
    signs are. Parquet files appear whole or not at all.

    Parameters
    ----------
    folder
        Existing output folder.
    log
        Stem of the log's file name, the first part of every sign's name.
    confidence
        Signs below get status `uncertain`.
    every_region
        Also list regions that the colour gate refused.
    antenna_m
        Where the antenna of the fixes is: right, down, ahead of the camera.

    Raises
    ------
    OutputError
        Where the folder cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        log: str,
        *,
        confidence: float,
        every_region: bool = False,
        antenna_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self._folder, self._log = folder, log
        self._confidence, self._every_region = confidence, every_region
        self._antenna_m = antenna_m
        self._places: list[Landmark] = []
        self._path: list[PathPoint] = []
        self._heights: list[float] = []
        self._verdicts: Counter[str] = Counter()
        self._frames: list[tuple[Any, ...]] = []
        self._scratch_path = folder / ".observations.scratch"
        self._observation_count = 0
        try:
            self._scratch = pa.OSFile(str(self._scratch_path), "wb")
        except OSError as error:
            raise _unwritable(folder, error) from error
        self._stream = pa.ipc.new_stream(self._scratch, OBSERVATIONS.schema)

    def append(self, settled: TrackedFrame) -> None:
        """Take one frame with its candidates and the places that ended with it."""
        self._places += [place for place in settled.landmarks if place.verdict == "sign"]
        point = PathPoint.of(settled)
        if point is not None:
            self._path.append(point)
        motion = settled.motion
        if motion is not None and math.isfinite(motion.camera_height_m):
            self._heights.append(motion.camera_height_m)
        self._frames.append(frame_row(settled))
        if settled.left_out:
            self._verdicts["left_out"] += settled.left_out
        batch = self._observations(settled)
        if batch.num_rows:
            try:
                self._stream.write_batch(batch)
            except OSError as error:
                raise _unwritable(self._folder, error) from error

    def discard(self) -> None:
        """Remove the scratch file; the run did not come to an end."""
        self._stream.close()
        self._scratch.close()
        self._scratch_path.unlink(missing_ok=True)

    def finish(self) -> Inventory:
        """Number the signs and write the tables."""
        self._stream.close()
        self._scratch.close()
        world = place_in_world(self._path, self._antenna_m)
        height = float(np.median(self._heights)) * world.stretch if self._heights else None
        ordered = sorted(self._places, key=lambda p: (p.station_m, p.right_m, p.track_id))
        signs = self._sign_rows(ordered, world, height)
        names = {p.track_id: row["sign_id"] for p, row in zip(ordered, signs, strict=True)}
        try:
            self._write_signs(signs, world)
            self._write_frames(world)
            self._write_observations(names)
        except OSError as error:
            raise _unwritable(self._folder, error) from error
        finally:
            self._scratch_path.unlink(missing_ok=True)
        rows = {
            SIGNS.file: len(signs),
            OBSERVATIONS.file: self._observation_count,
            FRAMES.file: len(self._frames),
        }
        return Inventory(signs, ordered, rows, dict(sorted(self._verdicts.items())), world, height)

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
        }
        return record_batch(OBSERVATIONS, values)

    def _write_observations(self, names: dict[int, str]) -> None:
        at = OBSERVATIONS.schema.get_field_index("sign_id")
        tracks = OBSERVATIONS.schema.get_field_index("track_id")
        with (
            ParquetFile(self._folder / OBSERVATIONS.file, OBSERVATIONS.schema) as sink,
            pa.OSFile(str(self._scratch_path), "rb") as scratch,
        ):
            waiting: list[pa.RecordBatch] = []
            for batch in pa.ipc.open_stream(scratch):
                followed = (-1 if t is None else int(t) for t in batch.column(tracks).to_pylist())
                named = pa.array([names.get(track) for track in followed], pa.string())
                waiting.append(batch.set_column(at, OBSERVATIONS.schema.field(at), named))
                if sum(b.num_rows for b in waiting) >= _BATCH_ROWS:
                    sink.write(waiting)
                    waiting = []
            sink.write(waiting)

    def _write_frames(self, world: World) -> None:
        rows = stretched_frames(self._frames, world)
        columns = list(zip(*rows, strict=True)) or [()] * len(FRAME_COLUMNS)
        values = dict(zip(FRAME_COLUMNS, columns, strict=True))
        poses = [world.poses.get(int(row[0])) for row in self._frames]
        blank = (None,) * 7
        placed = list(zip(*(blank if p is None else pose_numbers(p) for p in poses), strict=True))
        values |= dict(
            zip(("x", "y", "z", "qx", "qy", "qz", "qw"), placed or [()] * 7, strict=True)
        )
        with ParquetFile(self._folder / FRAMES.file, FRAMES.schema) as sink:
            sink.write([record_batch(FRAMES, values)])

    def _write_signs(self, signs: Sequence[dict[str, Any]], world: World) -> None:
        values = {name: [row[name] for row in signs] for name in SIGNS.schema.names}
        geo = None if world.earth is None else geoparquet_metadata(signs)
        with ParquetFile(self._folder / SIGNS.file, SIGNS.schema, geo) as sink:
            sink.write([record_batch(SIGNS, values)])

    def _sign_rows(
        self, places: Iterable[Landmark], world: World, camera_height_m: float | None
    ) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        assemblies: dict[int, str] = {}
        made = SignRows(world, self._frames, camera_height_m)
        for number, place in enumerate(places, 1):
            row = made.row(place)
            key = place.assembly if place.assembly >= 0 else -1 - place.track_id
            assembly = assemblies.setdefault(key, f"{self._log}-a{len(assemblies) + 1:04d}")
            row |= {
                "sign_id": f"{self._log}-{number:04d}",
                "assembly_id": assembly,
                "log": self._log,
            }
            if not place.back and row["confidence"] < self._confidence:
                row["status"] = "uncertain"
            rows.append(row)
        return rows


def _unwritable(folder: Path, error: OSError) -> OutputError:
    return OutputError(
        f"{folder}: wanted to write the result here, found: {error.strerror or error}; "
        "choose another folder with -o or free some space"
    )
