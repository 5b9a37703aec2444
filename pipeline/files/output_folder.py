"""Files and folders that belong together and replace the earlier ones all at once, whenever the process ends.

They are written into `.wayside-part` in the folder where they belong. When all are whole and on the disk, that
folder is renamed to `.wayside-done`. From then on the new result counts, and its files are moved into place. A process
that is killed before leaves the old result; one that is killed after leaves the moves to whoever opens the folder next,
`finish_replacement`.
"""

import json
import os
import shutil
from collections.abc import Collection
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from wayside.pipeline.files.parsing import parse_json
from wayside.pipeline.files.writing import (
    PART,
    give_back,
    not_written,
    require_local,
    sync,
    take_lock,
)
from wayside.schemas.errors import InputError, OutputError

DONE, LOCK = ".wayside-done", ".wayside-lock"
RECORDING = "drive.rrd"
"""The recording of every step, beside the tables where it is asked for."""
_MANIFEST = ".files.json"
_PATIENCE_S = 10.0
Kind = type[BaseException] | None


class OutputFolder:
    """A folder that one process at a time writes a set of files to; leaving the block without `commit` changes nothing.

    `folder`: where the files belong, made where it is missing. `kept`: files that stay in `part` where the block ends
    with an error that is not about the output. Raises OutputError where the folder cannot be written, or another
    process writes to it.
    """

    def __init__(self, folder: Path, kept: Collection[str] = ()) -> None:
        self.folder = folder
        self.part = folder / PART
        """Where the files are written until `commit`."""
        self._kept, self._ended = kept, ExitStack()

    def __enter__(self) -> Self:
        """Take the lock and make an empty `part`; what a killed process left is finished or removed."""
        require_local(self.folder)
        with ExitStack() as ended:
            try:
                if not self.folder.exists():
                    self.folder.mkdir(parents=True)
                    ended.push(self._remove_made)
                held = take_lock(self.folder / LOCK)
                if held is None:
                    raise OutputError(
                        f"{self.folder}: another wayside is writing its result here. Wait until it is done, or choose "
                        "another folder with -o."
                    )
                ended.callback(give_back, held)
                _move_into_place(self.folder)
                for scratch in (self.folder / DONE, self.part):
                    _remove(scratch)
                self.part.mkdir(mode=0o700)
            except OSError as error:
                raise not_written(self.folder, error) from error
            ended.push(self._remove_part)
            self._ended = ended.pop_all()
        return self

    def commit(self, drop: Collection[str] = ()) -> None:
        """Replace: what is in `part` goes to `folder`, files of an earlier result that are named in `drop` go away.

        Raises OutputError where a file cannot be brought to the disk; nothing has changed.
        """
        names = sorted(path.name for path in self.part.iterdir())
        try:
            for name in names:
                if (self.folder / name).is_dir() and not (self.part / name).is_dir():
                    raise OutputError(
                        f"{self.folder / name}: a folder has the name of a file to be written. Move it away."
                    )
            for path in self.part.rglob("*"):
                sync(path)
            manifest = self.part / _MANIFEST
            manifest.write_text(json.dumps([names, sorted(set(drop) - set(names))]))
            sync(manifest)
            sync(self.part)
            self.part.rename(self.folder / DONE)
            try:
                sync(self.folder)
            finally:  # also of an interrupt: it is too late to keep the old result
                _finish_moves(self.folder)
        except OSError as error:
            raise not_written(self.folder, error) from error

    def __exit__(
        self, kind: Kind, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove what was not committed, and give the lock back."""
        self._ended.__exit__(kind, error, trace)

    def _remove_part(self, kind: Kind, *_: object) -> None:
        keep = self._kept if kind is not None and not issubclass(kind, OutputError) else ()
        with suppress(OSError):  # what is kept keeps the folder
            for path in self.part.iterdir():
                if path.name not in keep:
                    _remove(path)
            self.part.rmdir()

    def _remove_made(self, kind: Kind, *_: object) -> None:
        if kind is not None:
            with suppress(OSError):  # it holds what is kept, or what others put there
                self.folder.rmdir()


def finish_replacement(folder: Path) -> None:
    """Complete a result whose writer was killed while it moved files; nearly always there is nothing to do.

    Raises InputError where another process is at it for too long, or the folder cannot be written.
    """
    if not _is_folder(folder / DONE):
        return
    try:
        held = take_lock(folder / LOCK, _PATIENCE_S)
        if held is None:
            raise InputError(f"{folder}: another wayside is replacing the result. Try again.")
        try:
            _move_into_place(folder)  # nothing, where another process has done it meanwhile
        finally:
            give_back(held)
    except OSError as error:
        raise InputError(
            f"{folder}: a new result is here that has not replaced the old one yet: {error.strerror or error}. "
            "Open it where the folder can be written."
        ) from error


def _finish_moves(folder: Path) -> None:
    """Move into place, even if the user interrupts it once."""
    try:
        _move_into_place(folder)
    except KeyboardInterrupt:
        _move_into_place(folder)
        raise


def _move_into_place(folder: Path) -> None:
    """Do the rest of a replacement. It can be repeated from any point with the same result."""
    done = folder / DONE
    if not _is_folder(done):
        return
    manifest = done / _MANIFEST
    if manifest.is_file():
        names, drop = _read_manifest(manifest)
        for name in names:
            if _is_folder(done / name) and (folder / name).exists():
                _remove(folder / name)
            with suppress(FileNotFoundError):  # moved before
                os.replace(done / name, folder / name)
        for name in drop:
            (folder / name).unlink(missing_ok=True)
        sync(folder)
    _remove(done)


def _read_manifest(manifest: Path) -> tuple[list[str], list[str]]:
    """The files to put into place, and the files to remove; no name leads out of the folder."""
    try:
        names, drop = ([str(name) for name in part] for part in parse_json(manifest.read_bytes()))
    except (ValueError, TypeError) as error:
        raise OSError(f"{manifest} is damaged ({error})") from error
    for name in (*names, *drop):
        if name != Path(name).name or name.startswith("."):
            raise OSError(f"{manifest} names {name!r}, which is not a file of a result")
    return names, drop


def _is_folder(path: Path) -> bool:
    """Whether a path is a folder and not a link to one."""
    return path.is_dir() and not path.is_symlink()


def _remove(path: Path) -> None:
    """Remove a file or a folder; the manifest goes first, so that a half is never taken for a result."""
    if _is_folder(path):
        (path / _MANIFEST).unlink(missing_ok=True)
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
