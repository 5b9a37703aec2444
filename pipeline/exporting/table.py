"""What can be exported, as rows of single values: a drive's signs beside their review, or a table of an inventory."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from wayside.pipeline.files.route_file import route_notes
from wayside.pipeline.fleet.folders import merged_parts, open_inventory, read_part
from wayside.pipeline.results.result import RUN_FILE, read_rows, read_run, result_name
from wayside.pipeline.results.routes import Row as Row
from wayside.pipeline.results.routes import with_route
from wayside.pipeline.reviewing.entries import LOOK, REJECTED, REVIEWS, Reviewed
from wayside.pipeline.reviewing.known import KnownResult
from wayside.pipeline.reviewing.matching import Review
from wayside.schemas.errors import InputError
from wayside.schemas.inventory_tables import PANELS, SUPPORTS
from wayside.schemas.settings import RouteSettings
from wayside.schemas.tables import FRAMES, POSTS, PROFILE, SIGNS, Column, Table

GEOMETRY = "geometry"
INVENTORY_TABLES = {table.name: table for table in (PANELS, SUPPORTS)}
_BOX = ("best_x_min", "best_y_min", "best_x_max", "best_y_max")
_WORLD = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
_EAST_NORTH_UP = ("cov_ee", "cov_en", "cov_eu", "cov_nn", "cov_nu", "cov_uu")
_MAIN_OF_BOTH = (
    *("status", "confidence", "category", "mutcd", "vienna", "legend", "color", "shape"),
    *("panel_width_m", "panel_height_m", "bearing_deg", "lon_deg", "lat_deg"),
    *("route", "measure", "measure_unit"),
)
_MAIN = {
    "signs": (*_MAIN_OF_BOTH, "sign_id", "bottom_m", "lateral_m", "date"),
    "panels": (*_MAIN_OF_BOTH, "panel_id", "up_m", "last_seen", "times_seen"),
}
"""The columns of an export unless all are asked for; in the drive's own frame other ones say where."""
_LOCAL = {"bearing_deg": "facing_deg", "lon_deg": "x", "lat_deg": "y"}
_REVIEW_COLUMNS = (
    Column("review", pa.string(), "", f"what a reviewer said: {', '.join(REVIEWS)}"),
    Column("reviewer", pa.string(), "", "who reviewed it"),
    Column("review_note", pa.string(), "", "the reviewer's remark"),
    Column(
        "result", pa.string(), "", "name of the result, by which a review of this table knows it"
    ),
)
_FINAL_COLUMNS = tuple(
    Column(f"final_{name}", pa.string(), "", f"{name}: what was reviewed, else what was measured")
    for name in LOOK
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
    notes: tuple[str, ...] = ()
    """What must be known of the rows."""


def is_inventory(folder: Path) -> bool:
    """Whether a folder is an inventory of many drives; raises InputError if there is no such folder."""
    if not os.path.isdir(folder):  # also answers for a name that no file can have
        raise InputError(
            f"there is no folder {folder}. Name a result of `wayside run` or an inventory of `wayside fleet`."
        )
    named = (folder / name for name in ("drives", *INVENTORY_TABLES))
    return not (folder / RUN_FILE).is_file() and any(path.is_dir() for path in named)


def drive_signs(
    out: Path, review: Review, route: RouteSettings | None = None, *, accepted: bool = False
) -> Source:
    """The signs of a result with their review; signs that the review says are missing stand last.

    `route`: instead of that of the run. `accepted`: without the rows that the review rejects.

    Raises InputError if the folder is no result folder, or damaged, and as `with_route`.
    """
    signs = read_rows(out, SIGNS, _names(SIGNS))
    about = read_run(out)
    rows = [_flat_row(SIGNS, row) | _said(review.rows.get(row["sign_id"]), row) for row in signs]
    rows += _missing(out, Path(str(about.get("log", ""))).stem, review)
    named = {"result": result_name(about)}
    shown = (row for row in rows if not (accepted and row.get("review") == REJECTED))
    rows = with_route(out, (row | named for row in shown), route)
    times = [row["best_time_ns"] for row in rows if row.get("best_time_ns") is not None]
    key, *measured = _flat_columns(SIGNS)
    columns = (key, *_FINAL_COLUMNS, *measured, *_REVIEW_COLUMNS)
    notes = route_notes(route, [row["route"] for row in rows]) if route else ()
    return replace(_drive_source(out, SIGNS.name, columns, rows, times), notes=tuple(notes))


def drive_roadside(out: Path, name: str) -> Source:
    """`profile` or `posts` of a result of `wayside run --roadside`; raises as `drive_signs`."""
    table = {one.name: one for one in (POSTS, PROFILE)}[name]
    rows = read_rows(out, table, _names(table))
    times = [row["log_time_ns"] for row in read_rows(out, FRAMES, ["log_time_ns"])]
    return _drive_source(out, name, _flat_columns(table), rows, times)


def _drive_source(
    out: Path, name: str, columns: tuple[Column, ...], rows: list[Row], times_ns: list[int]
) -> Source:
    last = datetime.fromtimestamp(max(times_ns, default=0) // 10**9, UTC)
    local = rows and all(row.get("lon_deg") is None for row in rows)
    world = str(read_run(out).get("world") or "drive_start") if local else None
    return Source(out, name, columns, lambda: [rows], last, world)


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


def main_columns(source: Source) -> tuple[Column, ...]:
    """The twenty columns that most need, and those that a review or a link adds; of other tables all."""
    main = _MAIN.get(source.name, tuple(column.name for column in source.columns))
    local = {} if source.world is None else _LOCAL
    wanted = {local.get(name, name) for name in main}
    measured = {column.name for column in (*_flat_columns(SIGNS), *_flat_columns(PANELS))}
    return tuple(c for c in source.columns if c.name in wanted or c.name not in measured)


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
            words = f"of `{column.name}`: {column.words}"
            flat += [Column(part, pa.float64(), column.unit, words) for part in parts]
        else:
            text = column.values or pa.types.is_list(column.type)
            kind = pa.string() if text else column.type
            # a rounded number has more digits again as a single
            kind = pa.float64() if pa.types.is_float32(kind) else kind
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


def _said(one: Reviewed | None, sign: Row) -> Row:
    measured = sign | {"code": sign.get("mutcd") or sign.get("vienna")}
    one = one or Reviewed("")
    row: Row = {f"final_{name}": value for name, value in one.final(measured).items()}
    about = {"review": one.review, "reviewer": one.reviewer, "review_note": one.note}
    return row | {name: value or None for name, value in about.items()}


def _missing(out: Path, log: str, review: Review) -> Iterator[Row]:
    """Rows of missing signs: their place as the reviewer gave it and what follows from it; nothing was measured."""
    known = KnownResult.of(out) if review.missing else None
    for number, one in enumerate(review.missing, 1):
        row: Row = {"sign_id": f"{log}-missing-{number}", "log": log, "x": one.x, "y": one.y}
        place = known.described(one.x or 0.0, one.y or 0.0) if known else {}
        if not place:
            raise InputError(
                f"{out}: the result has no path of the drive to place missing signs by"
            )
        yield row | place | _said(one, {})
