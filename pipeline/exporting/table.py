"""What can be exported, as rows of single values: a drive's signs beside their review, or a table of an inventory."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from wayside.pipeline.fleet.folders import merged_parts, open_inventory, read_part
from wayside.pipeline.results.result import RUN_FILE, read_rows, read_run
from wayside.pipeline.reviewing.review import REVIEWS, Review, Reviewed
from wayside.schemas.errors import InputError
from wayside.schemas.inventory_tables import PANELS, SUPPORTS
from wayside.schemas.settings import RouteSettings
from wayside.schemas.tables import FRAMES, PROFILE, SIGNS, Column, Table

Row = dict[str, Any]
"""Values by column name; one that is absent or None is unknown."""
GEOMETRY = "geometry"
INVENTORY_TABLES = {table.name: table for table in (PANELS, SUPPORTS)}
_BOX = ("best_x_min", "best_y_min", "best_x_max", "best_y_max")
_WORLD = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
_EAST_NORTH_UP = ("cov_ee", "cov_en", "cov_eu", "cov_nn", "cov_nu", "cov_uu")
_REVIEW_COLUMNS = (
    Column("review", pa.string(), "", f"what a reviewer said: {', '.join(REVIEWS)}"),
    Column("reviewed_color", pa.string(), "", "colour by the review"),
    Column("reviewed_shape", pa.string(), "", "shape by the review"),
    Column("reviewer", pa.string(), "", "who reviewed it"),
    Column("review_note", pa.string(), "", "the reviewer's remark"),
)


@dataclass(frozen=True, slots=True)
class Source:
    """Rows to export."""

    folder: Path
    name: str
    """Of the table, its layer and its default file."""
    columns: tuple[Column, ...]
    """Of all rows; the first one names a row."""
    chunks: Callable[[], Iterable[Sequence[Row]]]
    """Returns the rows, some at a time, from the beginning on each call."""
    last: datetime
    """The latest time that a row names, for formats that state when they were written."""
    world: str | None = None
    """Name of the drive's own frame if it has no place on WGS 84; None: rows have longitude and latitude."""


def is_inventory(folder: Path) -> bool:
    """Whether a folder is an inventory of many drives; raises InputError if there is no such folder."""
    if not os.path.isdir(folder):  # also answers for a name that no file can have
        raise InputError(
            f"there is no folder {folder}. Name a result of `wayside run` or an inventory of `wayside fleet`."
        )
    named = (folder / name for name in ("drives", *INVENTORY_TABLES))
    return not (folder / RUN_FILE).is_file() and any(path.is_dir() for path in named)


def drive_signs(out: Path, review: Review, route: RouteSettings | None = None) -> Source:
    """The signs of a result with their review; signs that the review says are missing stand last.

    route: with a milepost, instead of that of the run. Raises InputError if the folder is no result folder, or damaged.
    """
    signs = read_rows(out, SIGNS, _names(SIGNS))
    rows = [_flat_row(SIGNS, sign) | _said(review.rows.get(sign["sign_id"])) for sign in signs]
    rows += _missing(out, signs, review)
    for row in rows:
        if route is not None and row.get("station_m") is not None:
            row |= route.measured(row["station_m"])
    times = [row["best_time_ns"] for row in rows if row.get("best_time_ns") is not None]
    last = datetime.fromtimestamp(max(times, default=0) // 10**9, UTC)
    local = rows and all(row.get("lon_deg") is None for row in rows)
    world = str(read_run(out).get("world") or "drive_start") if local else None
    columns = (*_flat_columns(SIGNS), *_REVIEW_COLUMNS)
    return Source(out, SIGNS.name, columns, lambda: [rows], last, world)


def drive_profile(out: Path) -> Source:
    """The ground across the road of a result of `wayside run --roadside`; raises as `drive_signs`."""
    rows = read_rows(out, PROFILE, _names(PROFILE))
    last = max((row["log_time_ns"] for row in read_rows(out, FRAMES, ["log_time_ns"])), default=0)
    local = rows and all(row["lon_deg"] is None for row in rows)
    world = str(read_run(out).get("world") or "drive_start") if local else None
    columns = _flat_columns(PROFILE)
    when = datetime.fromtimestamp(last // 10**9, UTC)
    return Source(out, PROFILE.name, columns, lambda: [rows], when, world)


def inventory_rows(inventory: Path, name: str) -> Source:
    """One of `INVENTORY_TABLES`, in order of its cells; one cell is in memory at a time.

    Raises InputError if nothing is merged yet, or a part is damaged.
    """
    table = INVENTORY_TABLES[name]
    open_inventory(inventory, by_fleet=False)
    parts = merged_parts(inventory, name)
    if not parts:
        raise InputError(
            f"{inventory}: the inventory has no {name}, because nothing is merged yet or no drive has satellite "
            "fixes. `wayside fleet status` shows which; each folder in drives/ can be exported by itself."
        )
    seen = [pc.max(read_part(part, ["last_seen"])["last_seen"]).as_py() for part in parts]

    def chunks() -> Iterator[Sequence[Row]]:
        for part in parts:
            yield [_flat_row(table, row) for row in read_part(part, _names(table)).to_pylist()]

    return Source(inventory, name, _flat_columns(table), chunks, max(seen))


def _names(table: Table) -> list[str]:
    return [column.name for column in table.columns if column.name != GEOMETRY]


def _parts(table: Table, name: str) -> tuple[str, ...]:
    """The columns that a column of lists of numbers becomes."""
    covariance = _WORLD if table is SIGNS else _EAST_NORTH_UP
    return {"covariance": covariance, "best_box": _BOX}.get(name, ())


def _flat_columns(table: Table) -> tuple[Column, ...]:
    """One column for each element of a list of numbers; choices and lists of names are text."""
    flat: list[Column] = []
    for column in table.columns:
        if column.name == GEOMETRY:
            continue
        if parts := _parts(table, column.name):
            kind = column.type.value_type  # type: ignore[attr-defined]  # of a list, which the stubs do not say
            words = f"of `{column.name}`: {column.words}"
            flat += [Column(part, kind, column.unit, words) for part in parts]
        else:
            text = column.values or pa.types.is_list(column.type)
            kind = pa.string() if text else column.type
            flat.append(Column(column.name, kind, column.unit, column.words))
    return tuple(flat)


def _flat_row(table: Table, row: Row) -> Row:
    flat: Row = {}
    for name, value in row.items():
        if parts := _parts(table, name):
            flat |= dict(zip(parts, value or [None] * len(parts), strict=True))
        else:
            flat[name] = ", ".join(value) if isinstance(value, list) else value
    return flat


def _said(one: Reviewed | None) -> Row:
    if one is None:
        return {}
    values = (one.review, one.color, one.shape, one.reviewer or None, one.note or None)
    return {column.name: value for column, value in zip(_REVIEW_COLUMNS, values, strict=True)}


def _missing(out: Path, signs: Sequence[Row], review: Review) -> Iterator[Row]:
    """Rows of missing signs: their place as the reviewer gave it, and nothing that was measured."""
    if not review.missing:
        return
    columns = ["frame", "x", "y", "station_m"]
    path = [row for row in read_rows(out, FRAMES, columns) if row["x"] is not None]
    if not path:
        raise InputError(f"{out}: the result has no path of the drive to place missing signs by")
    cameras = np.array([[row["x"], row["y"]] for row in path], np.float64)
    log = signs[0]["log"] if signs else Path(str(read_run(out).get("log", ""))).stem
    to_globe = _globe_fit(signs)
    for number, one in enumerate(review.missing, 1):
        place = np.array([one.x, one.y], np.float64)
        nearest = path[int(np.argmin(np.linalg.norm(cameras - place, axis=1)))]
        row: Row = {"sign_id": f"{log}-missing-{number}", "log": log, "x": one.x, "y": one.y}
        row |= {"station_m": nearest["station_m"], "best_frame": nearest["frame"]}
        if to_globe is not None:
            lon, lat = np.array([1.0, *place]) @ to_globe
            row |= {"lon_deg": float(lon), "lat_deg": float(lat)}
        yield row | _said(one)


def _globe_fit(signs: Sequence[Row]) -> NDArray[np.float64] | None:
    """Matrix (3, 2) from 1, x, y to longitude and latitude by least squares over the signs; None where they tell none.

    Over the length of a drive the globe is plane enough for a place that a person clicked on a map.
    """
    known = [sign for sign in signs if sign["lon_deg"] is not None]
    world = np.array([[1.0, sign["x"], sign["y"]] for sign in known], np.float64).reshape(-1, 3)
    if np.linalg.matrix_rank(world) < 3:
        return None
    globe = np.array([[sign["lon_deg"], sign["lat_deg"]] for sign in known], np.float64)
    return np.asarray(np.linalg.lstsq(world, globe, rcond=None)[0])
