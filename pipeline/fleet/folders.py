"""An inventory on disk: its lock, and the merged tables, which replace the earlier ones together."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from wayside.pipeline.files.output_folder import OutputFolder, finish_replacement
from wayside.pipeline.files.parquet import read_parquet
from wayside.pipeline.files.writing import give_back, not_written, refuse, require_local, take_lock
from wayside.pipeline.fleet.manifest import MANIFEST, Manifest, read_manifest
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.inventory_tables import PANELS, SIGHTINGS, SUPPORTS
from wayside.schemas.settings import ChangeSettings, MergeSettings
from wayside.schemas.tables import Table

MERGED = (PANELS.name, SUPPORTS.name, SIGHTINGS.name)
"""Folders of an inventory that a merging writes."""
CELL = "cell="
"""What the names of the folders of a table begin with; a quadkey follows."""
_ABOUT = b"wayside"
_LOCK = ".wayside-fleet-lock"


@contextmanager
def locked_inventory(inventory: Path) -> Iterator[None]:
    """One fleet at a time in a block; the folder is made where it is missing. Raises OutputError."""
    require_local(inventory)
    try:
        inventory.mkdir(parents=True, exist_ok=True)
        lock = take_lock(inventory / _LOCK)
    except OSError as error:
        raise not_written(inventory, error, "the inventory") from error
    if lock is None:
        raise OutputError(
            f"{inventory}: another fleet is writing an inventory here. Wait until it is done (`wayside fleet status "
            f"{inventory}`), or choose another folder with -o."
        )
    try:
        yield
    finally:
        give_back(lock)


def is_under_way(inventory: Path) -> bool:
    """Whether a fleet writes to an inventory now."""
    if not (inventory / _LOCK).exists():
        return False
    try:
        lock = take_lock(inventory / _LOCK)
    except OSError:  # not ours to write: nobody here can tell
        return False
    if lock is not None:
        lock.release()
    return lock is None


@contextmanager
def replaced_tables(inventory: Path) -> Iterator[Path]:
    """A scratch folder with empty folders of the merged tables; they replace the others if the block ends well.

    Raises OutputError where they cannot be written, or hold files that no merging wrote.
    """
    with OutputFolder(inventory) as output:
        try:
            for name in MERGED:
                _require_own(inventory / name)
                (output.part / name).mkdir()
            yield output.part
        except OSError as error:
            raise not_written(inventory, error) from error
        output.commit()


def open_inventory(inventory: Path, *, by_fleet: bool = True) -> Manifest:
    """Make an inventory whole, if a merging was killed when it moved its tables to their place, to read it.

    `by_fleet`: whether only a fleet's will do; else one that was merged without has an empty manifest. Raises
    InputError where it is no inventory, its manifest is damaged, or the tables cannot be moved.
    """
    finish_replacement(inventory)
    if by_fleet or (inventory / MANIFEST).exists():
        return read_manifest(inventory)
    return Manifest()


def is_merged(inventory: Path) -> bool:
    """Whether all merged tables are there."""
    return all((inventory / name).is_dir() for name in MERGED)


def merged_parts(inventory: Path, name: str) -> list[Path]:
    """The files of a merged table, one a cell, in order."""
    return sorted((inventory / name).glob(f"{CELL}*/part-0.parquet"))


def read_part(part: Path, columns: Sequence[str]) -> pa.Table:
    """Columns of one file of a merged table; raises InputError where it is damaged, or lacks a column."""
    try:
        return read_parquet(part, columns)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(
            f"{part} cannot be read: {error}; it is damaged or of an earlier version: remove {part.parent.parent} and "
            "run the fleet once more, which merges its drives again"
        ) from error


def schema_with_settings(table: Table, **groups: MergeSettings | ChangeSettings) -> pa.Schema:
    """The schema of a table with groups of settings, by name, in its metadata under the key `wayside`."""
    about = json.loads((table.schema.metadata or {})[_ABOUT])
    about["settings"] = {name: asdict(group) for name, group in groups.items()}
    return table.schema.with_metadata({_ABOUT: json.dumps(about).encode()})


def merge_settings_of(part: Path) -> MergeSettings:
    """The settings that a part was merged with, defaults where an earlier version did not say; raises OSError."""
    about = json.loads((pq.read_schema(part).metadata or {}).get(_ABOUT, b"{}"))
    said = about.get("settings", {}).get("merge", {})
    known = {each.name for each in fields(MergeSettings)}
    return MergeSettings(**{name: value for name, value in said.items() if name in known})


def _require_own(folder: Path) -> None:
    """Refuse a folder that holds anything but the parts of a table."""
    if not folder.exists() and not folder.is_symlink():
        return
    own = folder.is_dir() and not folder.is_symlink()
    if not own or not all(
        path.name == "part-0.parquet" or (path.is_dir() and path.name.startswith(CELL))
        for path in folder.rglob("*")
    ):
        raise refuse(folder, "something that is not a table of an inventory")
