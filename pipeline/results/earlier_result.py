"""The content of the folder that a run writes to: an earlier result of the same log, or something to keep."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.output_folder import RECORDING
from wayside.pipeline.files.parsing import parse_json
from wayside.pipeline.files.writing import not_written
from wayside.pipeline.reading.parts import bag_parts
from wayside.pipeline.results.result import RUN_FILE
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

TABLES = (SIGNS.file, OBSERVATIONS.file, FRAMES.file)
_END_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class EarlierResult:
    """What a folder holds before a run."""

    folder: Path
    """The folder."""
    recorded: bool
    """Whether a recording belongs to the result there."""
    overwrite: bool
    """Whether anything there may be replaced."""

    def check_recording(self) -> None:
        """Make sure that a recording may be written; raises OutputError if it would replace a file of the user's."""
        if not self.recorded and not self.overwrite and _is_there(self.folder, RECORDING):
            raise _refused(self.folder, RECORDING, "not part of the result there")


def log_fingerprint(log: Path) -> str | None:
    """Which recording a log is, wherever it lies: a digest of its length and its first and last mebibyte.

    That of a bag directory is of its parts. None where it cannot be told.
    """
    digests = []
    try:
        for file in bag_parts(log) if log.is_dir() else [log]:
            if not file.is_file():
                return None
            with file.open("rb") as stream:
                digests.append(stream_fingerprint(stream, file.stat().st_size))
    except (OSError, InputError):
        return None
    return (
        digests[0] if len(digests) == 1 else hashlib.sha256(" ".join(digests).encode()).hexdigest()
    )


def stream_fingerprint(stream: BinaryIO, size: int) -> str:
    """The same of an open file of so many bytes, wherever it is stored; raises OSError where it cannot be read."""
    digest = hashlib.sha256(str(size).encode())
    digest.update(stream.read(_END_BYTES))
    stream.seek(max(size - _END_BYTES, 0))
    digest.update(stream.read(_END_BYTES))
    return digest.hexdigest()


def file_digest(path: Path) -> str:
    """SHA-256 of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def check_earlier(folder: Path, log: Path, *, overwrite: bool = False) -> EarlierResult:
    """Make sure that a run loses nothing of the user's.

    A result of the same log, by its fingerprint, may be replaced where each table is as `run.json` states it; with
    `overwrite`, whatever stands there.

    Raises OutputError where a result of another log stands there, or files that no run of wayside has left there.
    """
    standing = [name for name in (*TABLES, RUN_FILE) if _is_there(folder, name)]
    run = _read_run(folder)
    found = EarlierResult(folder, run is not None and run.get("recording") is not None, overwrite)
    if overwrite or not standing:
        return found
    if run is None:
        raise _refused(folder, ", ".join(standing), "not a result of wayside")
    stated = run.get("log_fingerprint")
    if stated is None or stated != log_fingerprint(log):
        other = f"the result of {run.get('log_path') or run.get('log')}"
        raise _refused(folder, other, "of another log")
    try:
        foreign = [name for name in standing if not _is_as_stated(folder, name, run)]
    except OSError as error:
        raise not_written(folder, error) from error
    if foreign:
        raise _refused(folder, ", ".join(foreign), "not as its run.json states")
    return found


def is_finished(folder: Path, key: str | None) -> bool:
    """Whether the result in a folder is of the same log, settings and models (`result_key`), and as its run left it."""
    run = _read_run(folder)
    if run is None or key is None or run.get("result_key") != key:
        return False
    return all(_is_as_stated(folder, name, run) for name in run["files"])


def _is_as_stated(folder: Path, name: str, run: dict[str, Any]) -> bool:
    """Whether a file is one that the run of `run.json` has left."""
    stated = run["files"].get(name)
    path = folder / name
    return name == RUN_FILE or (
        isinstance(stated, dict) and path.is_file() and stated.get("sha256") == file_digest(path)
    )


def _read_run(folder: Path) -> dict[str, Any] | None:
    """Content of `run.json`, or None if it was not written by wayside."""
    try:
        run = parse_json(read_input_text(folder / RUN_FILE))
    except (OSError, ValueError):
        return None
    known = isinstance(run, dict) and "wayside" in run and isinstance(run.get("files"), dict)
    return run if known else None


def _is_there(folder: Path, name: str) -> bool:
    path = folder / name
    return path.is_symlink() or path.exists()


def _refused(folder: Path, found: str, why: str) -> OutputError:
    return OutputError(
        f"{folder}: the result cannot be written here, because the folder holds {found} ({why}). Choose another "
        "folder with -o, or replace it with --overwrite."
    )
