"""Writes the three tables of a result, in memory that grows with the signs and not with the pictures."""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from wayside.pipeline.parquet import (
    ParquetFile,
    choice,
    fixed_list,
    geoparquet_metadata,
    known,
    record_batch,
)
from wayside.pipeline.world import PathPoint, World, beside_in_world, place_in_world
from wayside.schemas.errors import OutputError
from wayside.schemas.frame import Pose
from wayside.schemas.motion import Motion, Place, Settled
from wayside.schemas.regions import VERDICTS
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

_BATCH_ROWS = 4096
_UNLISTED = tuple(VERDICTS.index(name) for name in ("size", "color", "glance"))


@dataclass(frozen=True, slots=True)
class Inventory:
    """What was written: sign rows in the order of the file and their places, counts, the world they stand in."""

    signs: list[dict[str, Any]]
    places: list[Place]
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

    Raises
    ------
    OutputError
        Where the folder cannot be written.
    """

    def __init__(
        self, folder: Path, log: str, *, confidence: float, every_region: bool = False
    ) -> None:
        self._folder, self._log = folder, log
        self._confidence, self._every_region = confidence, every_region
        self._places: list[Place] = []
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

    def append(self, settled: Settled) -> None:
        """Take one frame with its candidates and the places that ended with it."""
        frame, motion = settled.frame, settled.motion
        self._places += [place for place in settled.places if place.verdict == "sign"]
        if motion is not None:
            given = frame.pose.pose if frame.pose is not None else None
            self._path.append(PathPoint(frame.index, motion.pose, given, frame.fix))
            if math.isfinite(motion.camera_height_m):
                self._heights.append(motion.camera_height_m)
        self._frames.append(_frame_row(settled))
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
        world = place_in_world(self._path)
        height = float(np.median(self._heights)) if self._heights else None
        ordered = sorted(self._places, key=lambda p: (p.station_m, p.offset[0], p.track_id))
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

    def _observations(self, settled: Settled) -> pa.RecordBatch:
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
        columns = list(zip(*self._frames, strict=True)) or [()] * len(_FRAME_COLUMNS)
        values = dict(zip(_FRAME_COLUMNS, columns, strict=True))
        poses = [world.poses.get(int(row[0])) for row in self._frames]
        blank = (None,) * 7
        placed = list(zip(*(blank if p is None else _numbers(p) for p in poses), strict=True))
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
        self, places: Iterable[Place], world: World, camera_height_m: float | None
    ) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        assemblies: dict[int, str] = {}
        frames = sorted(world.poses)
        for number, place in enumerate(places, 1):
            row = _sign_row(place, world, frames, camera_height_m)
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
        blank = dict.fromkeys(("lon_deg", "lat_deg", "alt_m", "geometry"))
        if world.earth is None or not rows:
            return [row | blank for row in rows]
        points = world.earth.geodetic(np.array([[r["x"], r["y"], r["z"]] for r in rows]))
        return [
            row
            | {"lon_deg": lon, "lat_deg": lat, "alt_m": alt}
            | {"geometry": struct.pack("<BIddd", 1, 1001, lon, lat, alt)}
            for row, (lon, lat, alt) in zip(rows, points.tolist(), strict=True)
        ]


_FRAME_COLUMNS = (
    *(
        "frame",
        "log_time_ns",
        "header_time_ns",
        "status",
        "station_m",
        "motion_source",
        "baseline_m",
        "ties",
    ),
    *("residual_straight_px", "residual_px", "adjusted", "iterations", "regions", "candidates"),
)


def _frame_row(settled: Settled) -> tuple[Any, ...]:
    frame, motion = settled.frame, settled.motion
    head = (frame.index, frame.log_time_ns, frame.header_time_ns, frame.status)
    if motion is None:
        return (*head, *(None,) * 10)
    return (
        *head,
        motion.station_m,
        motion.source,
        *_step(motion),
        settled.region_count,
        len(settled.candidates),
    )


def _step(motion: Motion) -> tuple[Any, ...]:
    """Columns of the step to a frame; unknown at the first used one."""
    if motion.step is None:
        return (None,) * 6
    ties = 0 if motion.ties is None else len(motion.ties.inlier)
    residuals = (_finite(motion.residual_straight_px), _finite(motion.residual_px))
    return (motion.baseline_m, ties, *residuals, motion.adjusted, motion.iterations)


def _sign_row(
    place: Place, world: World, frames: Sequence[int], camera_height_m: float | None
) -> dict[str, Any]:
    """All columns of a sign that need neither its number nor the earth."""
    pose = world.poses[place.best_frame]
    centre = pose.to_world(place.position)
    beside = beside_in_world(world, frames, place.best_frame, centre)
    right, above = place.offset[:2] if beside is None else (beside.right, beside.above)
    spread = pose.rotation @ place.covariance @ pose.rotation.T
    sigma = np.sqrt(np.diag(place.covariance))
    up = None if camera_height_m is None else float(above) + camera_height_m
    return {
        "status": "back" if place.back else "sign",
        "confidence": 1 / (1 + math.exp(-min(max(place.score, -50.0), 50.0))),
        "color": place.color,
        "color_distance": _finite(place.color_distance),
        "shape": place.shape,
        "shape_distance": _finite(place.shape_distance),
        **dict(zip(("x", "y", "z"), centre.tolist(), strict=True)),
        "covariance": [spread[i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))],
        "sigma_along_m": float(sigma[2]),
        "sigma_lateral_m": float(sigma[0]),
        "sigma_up_m": float(sigma[1]),
        "station_m": place.station_m,
        "lateral_m": float(right),
        "up_m": up,
        "bottom_m": None if up is None else up - place.height_m / 2,
        "panel_width_m": _finite(place.width_m),
        "panel_height_m": _finite(place.height_m),
        "sigma_width_m": _finite(place.sigma_width_m),
        "sigma_height_m": _finite(place.sigma_height_m),
        "facing_deg": _finite(place.facing_deg),
        "sigma_facing_deg": _finite(place.sigma_facing_deg),
        "best_frame": place.best_frame,
        "best_time_ns": place.best_time_ns,
        "best_box": list(place.best_box),
        **dict(zip(("right_m", "down_m", "ahead_m"), place.position.tolist(), strict=True)),
        "first_frame": min(view.frame for view in place.views),
        "last_frame": max(view.frame for view in place.views),
        "views": len(place.views),
        "residual_px": _finite(place.residual_px),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(pose: Pose) -> tuple[float, ...]:
    quaternion = Rotation.from_matrix(pose.rotation).as_quat(canonical=True)
    return (*pose.centre.tolist(), *quaternion.tolist())


def _unwritable(folder: Path, error: OSError) -> OutputError:
    return OutputError(
        f"{folder}: wanted to write the result here, found: {error.strerror or error}; "
        "choose another folder with -o or free some space"
    )
