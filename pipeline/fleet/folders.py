"""Folders of the merged tables of an inventory. They replace the earlier ones together, whenever the process ends.

They are written into a scratch folder. From the moment when it is renamed, the new tables count. They are then moved
into place, which the next `open_inventory` continues after an interruption.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa

from wayside.pipeline.files.input_files import read_parquet
from wayside.pipeline.files.output_folder import finish_under_lock
from wayside.pipeline.files.writing import not_written, refuse, sync
from wayside.pipeline.fleet.manifest import MANIFEST, Manifest, read_manifest
from wayside.schemas.errors import InputError

LOCK = ".wayside-fleet-lock"
CELL = "cell="
"""What the names of the folders of a table begin with; a quadkey follows."""
_PART, _DONE = ".wayside-merge-part", ".wayside-merge-done"


@contextmanager
def replaced_folders(inventory: Path, names: tuple[str, ...]) -> Iterator[Path]:
    """A scratch folder with empty folders of the names; they replace those of the inventory if the block ends well.

    Raises
    ------
    OutputError
        They cannot be written, or something stands there that no merging wrote.
    """
    part = inventory / _PART
    try:
        inventory.mkdir(parents=True, exist_ok=True)
        _move_into_place(inventory)
        for name in names:
            _require_own(inventory / name)
        shutil.rmtree(part, ignore_errors=True)
        for name in names:
            (part / name).mkdir(parents=True)
        yield part
        for folder in sorted(part.rglob("*")):
            sync(folder)
        part.rename(inventory / _DONE)
        sync(inventory)
        _move_into_place(inventory)
    except OSError as error:
        raise not_written(inventory, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def open_inventory(inventory: Path, *, by_fleet: bool = True) -> Manifest:
    """Make an inventory whole, if a merging was killed when it moved its tables to their place, to read it.

    Parameters
    ----------
    inventory
        The folder.
    by_fleet
        Whether only a fleet's will do; else one that was merged without has an empty manifest.

    Raises
    ------
    InputError
        It is no inventory, its manifest is damaged, or the tables cannot be moved.
    """
    finish_under_lock(inventory, _DONE, LOCK, _move_into_place)
    if by_fleet or (inventory / MANIFEST).exists():
        return read_manifest(inventory)
    return Manifest()


def _move_into_place(inventory: Path) -> None:
    """Move what a merging wrote to its place; raises OSError where it cannot be moved."""
    done = inventory / _DONE
    if not done.is_dir():
        return
    for folder in sorted(done.iterdir()):
        target = inventory / folder.name
        if target.exists():
            shutil.rmtree(target)
        folder.rename(target)
    done.rmdir()
    sync(inventory)


def _require_own(folder: Path) -> None:
    """Refuse a folder that holds anything but the parts of a table."""
    if not folder.exists() and not folder.is_symlink():
        return
    own = folder.is_dir() and not folder.is_symlink()
    if own:
        own = all(
            path.name == "part-0.parquet" or (path.is_dir() and path.name.startswith(CELL))
            for path in folder.rglob("*")
        )
    if not own:
        raise refuse(folder, "something that is not a table of an inventory")


def merged_parts(inventory: Path, name: str) -> list[Path]:
    """The files of a merged table, one a cell, in order."""
    return sorted((inventory / name).glob(f"{CELL}*/part-0.parquet"))


def read_part(part: Path, columns: Sequence[str]) -> pa.Table:
    """Columns of one file of a merged table.

    Raises
    ------
    InputError
        It is damaged, or lacks a column.
    """
    try:
        return read_parquet(part, columns)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(
            f"{part} cannot be read: {error}; it is damaged or of an earlier version: remove {part.parent.parent} and "
            "run the fleet once more, which merges its drives again"
        ) from error
