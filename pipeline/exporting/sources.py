"""What can be exported: the signs of a drive, or a table of an inventory, area after area."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pyarrow.compute as pc

from wayside.pipeline.exporting.flat_table import (
    FlatTable,
    flat_columns,
    flat_row,
    flat_table,
    kept_columns,
)
from wayside.pipeline.fleet.folders import merged_parts, open_inventory, read_part
from wayside.pipeline.results.result import RUN_FILE, read_run
from wayside.pipeline.reviewing.review import Review
from wayside.schemas.errors import InputError
from wayside.schemas.inventory_tables import PANELS, SUPPORTS
from wayside.schemas.tables import SIGNS, Column

INVENTORY_TABLES = {table.name: table for table in (PANELS, SUPPORTS)}
"""What an inventory has for other programs, by name."""


@dataclass(frozen=True, slots=True)
class Source:
    """Rows to export."""

    folder: Path
    """For messages."""
    table: str
    """Name of the table, also of layers and default files."""
    columns: tuple[Column, ...]
    """Of all rows."""
    chunks: Callable[[], Iterable[FlatTable]]
    """Returns the rows, some at a time, from the beginning on each call."""
    last: datetime
    """The latest time that a row names, for formats that state when they were written."""
    world: str | None = None
    """Name of the drive's own frame without a place on WGS 84. None: rows have longitude and latitude."""

    @property
    def key(self) -> str:
        """The column that names a row."""
        return self.columns[0].name


def is_inventory(folder: Path) -> bool:
    """Whether a folder is an inventory of many drives.

    Raises
    ------
    InputError
        There is no such folder.
    """
    if not os.path.isdir(folder):  # says so too of a name that no file can have
        raise InputError(
            f"there is no folder {folder}. Name a result of `wayside run` or an inventory of `wayside fleet`."
        )
    named = (folder / name for name in ("drives", *INVENTORY_TABLES))
    return not (folder / RUN_FILE).is_file() and any(path.is_dir() for path in named)


def drive_signs(out: Path, review: Review) -> Source:
    """The signs of a result, with what a review says of them.

    Raises
    ------
    InputError
        The folder is no result folder, or damaged.
    """
    table = flat_table(out, review)
    times = [row["best_time_ns"] for row in table.rows if row.get("best_time_ns") is not None]
    last = datetime.fromtimestamp(max(times, default=0) // 10**9, UTC)
    local = table.rows and all(row.get("lon_deg") is None for row in table.rows)
    world = str(read_run(out).get("world") or "drive_start") if local else None
    return Source(out, SIGNS.name, table.columns, lambda: (table,), last, world)


def inventory_rows(inventory: Path, name: str) -> Source:
    """A table of an inventory, in order of its cells; one cell is in memory at a time.

    Parameters
    ----------
    inventory
        Folder that `wayside fleet` wrote.
    name
        One of `INVENTORY_TABLES`.

    Raises
    ------
    InputError
        Nothing is merged yet, or a part is damaged.
    """
    table = INVENTORY_TABLES[name]
    open_inventory(inventory, by_fleet=False)
    parts = merged_parts(inventory, name)
    if not parts:
        raise InputError(
            f"{inventory}: the inventory has no {name}, because nothing is merged yet or no drive has satellite "
            "fixes. `wayside fleet status` shows which; each folder in drives/ can be exported by itself."
        )
    columns = flat_columns(table)
    wanted = [column.name for column in kept_columns(table)]
    seen = [pc.max(read_part(part, ["last_seen"])["last_seen"]).as_py() for part in parts]

    def chunks() -> Iterator[FlatTable]:
        for part in parts:
            rows = read_part(part, wanted).to_pylist()
            yield FlatTable(columns, tuple(flat_row(table, row) for row in rows))

    return Source(inventory, name, columns, chunks, max(seen))
