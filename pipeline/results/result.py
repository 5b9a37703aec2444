"""Reading back a folder that `wayside run` has written, and what of it another run may replace."""

import difflib
import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.output_folder import RECORDING, finish_replacement
from wayside.pipeline.files.parquet import Where, read_parquet
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.files.writing import not_written, write_file
from wayside.pipeline.reading.parts import bag_parts, is_bag
from wayside.schemas.errors import InputError, OutputError, UsageError
from wayside.schemas.settings import ReadSettings
from wayside.schemas.tables import FRAMES, OBSERVATIONS, ROADSIDE, SIGNS, Table

RUN_FILE = "run.json"
TABLES = (SIGNS.file, OBSERVATIONS.file, FRAMES.file)
_END_BYTES = 1 << 20
_OLDER = (
    '<p role="alert" style="border: 3px solid var(--accent); padding: 8px">This page is from an earlier result. Run '
    "<code>wayside evidence</code> again; a review saved here is carried over.</p>"
)
_KINDS: dict[str, type | UnionType] = {
    "log": str,
    "log_path": str | None,
    "log_fingerprint": str | None,
    "camera_topic": str | None,
    "camera": dict | None,
    "files": dict,
    "learned_from_log": list,
    "world": str | None,
}
"""Entries of `run.json` that are read again, each where it is there."""


def read_table(
    out: Path, table: Table, columns: Sequence[str] | None = None, where: Where | None = None
) -> pa.Table:
    """One table of a result folder.

    `columns`: those to read; None: all. Columns that an earlier version did not write come as null. `where`: the rows;
    its columns need not be among `columns`. Raises InputError where the folder is not a result, or the file is damaged,
    has a column of another type, or lacks values that every row must have.
    """
    finish_replacement(out)
    file, schema = out / table.file, table.schema
    if not file.is_file():
        raise _no_result(out, table.file)
    wanted = schema.names if columns is None else list(columns)
    try:
        present = set(pq.read_schema(file).names)
        found = read_parquet(file, [name for name in wanted if name in present], where)
        for name in wanted:
            if name not in present:
                column = schema.field(name)
                if not column.nullable:
                    raise InputError(f"{file} lacks the column {name}: wayside did not write it")
                found = found.append_column(column, pa.nulls(len(found), column.type))
        return _typed(found.select(wanted), schema)
    except (pa.ArrowException, OSError, *CONTENT_FAULTS) as error:
        raise InputError(f"{file} cannot be read: {error}") from error


def _typed(found: pa.Table, schema: pa.Schema) -> pa.Table:
    """The columns in the types of the schema; raises pa.ArrowException where one holds something else."""
    for number, name in enumerate(found.column_names):
        field, column = schema.field(name), found.column(number)
        kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
        if not pa.types.is_dictionary(column.type) or column.type.value_type != kind:
            if column.type != kind:
                found = found.set_column(number, field.with_type(kind), column.cast(kind))
        if column.null_count and not field.nullable:
            raise pa.ArrowInvalid(f"column {name} lacks {column.null_count} of its values")
    return found


def read_rows(
    out: Path, table: Table, columns: Sequence[str], where: Where | None = None
) -> list[dict[str, Any]]:
    """Rows of one table of a result, null as None. Takes and raises the same as `read_table`."""
    rows: list[dict[str, Any]] = read_table(out, table, columns, where).to_pylist()
    return rows


def holds_table(file: Path, table: Table) -> bool:
    """Whether a file is this table, written by wayside."""
    try:
        about = (pq.read_schema(file).metadata or {}).get(b"wayside", b"")
    except (OSError, ValueError):
        return False
    return f'"table": "{table.name}"'.encode() in about


def read_times(out: Path) -> dict[int, int]:
    """Log time of each frame of a result, nanoseconds."""
    rows = read_rows(out, FRAMES, ["frame", "log_time_ns"])
    return {row["frame"]: row["log_time_ns"] for row in rows}


def find_sign(out: Path, signs: Sequence[dict[str, Any]], sign_id: str) -> dict[str, Any]:
    """The row of a sign. Raises UsageError for an unknown sign; its message names the nearest."""
    by_id = {row["sign_id"]: row for row in signs}
    if sign_id not in by_id:
        near = difflib.get_close_matches(sign_id, by_id, n=1, cutoff=0.0)
        offered = f" among {len(by_id)}. Did you mean {near[0]}?" if near else ", as it has none."
        raise UsageError(f"--sign {sign_id}: {out} has no such sign{offered}")
    return by_id[sign_id]


def read_run(out: Path) -> dict[str, Any]:
    """Content of `run.json`; raises InputError where the folder has none, or it is damaged."""
    finish_replacement(out)
    file = out / RUN_FILE
    if not file.is_file():
        raise _no_result(out, RUN_FILE)
    try:
        run = parse_json(read_input_text(file))
    except (OSError, ValueError) as error:
        raise InputError(f"{file} cannot be read: {error}; run the log again") from error
    if not isinstance(run, dict):
        raise InputError(f"{file}: the file was not written by `wayside run`")
    odd = [name for name, kind in _KINDS.items() if name in run and not isinstance(run[name], kind)]
    if odd:
        raise InputError(f"{file}: {odd[0]} is not of the kind that `wayside run` writes")
    return run


def result_name(run: Mapping[str, Any]) -> str:
    """What tells the signs of one result from those of another run: the start of the digest of their table."""
    stated = run.get("files", {}).get(SIGNS.file)
    return str(stated.get("sha256", "") if isinstance(stated, dict) else "")[:16]


def read_settings(out: Path, run: dict[str, Any]) -> ReadSettings:
    """How the log of a result was read; raises InputError where this version cannot tell."""
    try:
        group = run["settings"]["read"]
        options = {f"read.{name}": value for name, value in group.items()}
        return load_settings(options=options)[0].read
    except (*CONTENT_FAULTS, UsageError) as error:
        raise InputError(
            f"{out / RUN_FILE}: the settings of the run cannot be read: {error}. Another version of wayside wrote "
            "them: run the log again."
        ) from error


def find_log(run: dict[str, Any], given: Path | None) -> Path:
    """The log that a result was made from: the one given, else where it lay then; raises InputError without one."""
    noted = run.get("log_path")
    if given is None and noted is None:
        raise InputError(
            f"images are taken from the log {run.get('log', '')}, and {RUN_FILE} does not state where it is. Name it "
            "with --log."
        )
    log = Path(noted or "") if given is None else given
    if not log.is_file() and not is_bag(log):
        found = "a folder" if log.is_dir() else "not there"
        advice = "Name its place with --log." if given is None else "Give a log with --log."
        raise InputError(f"images are taken from the log {log}, which is {found}. {advice}")
    return log


def _no_result(out: Path, name: str) -> InputError:
    return InputError(
        f"{out} is not a result folder: it has no {name}; `wayside run LOG -o {out}` writes one"
    )


@dataclass(frozen=True, slots=True)
class EarlierResult:
    """What a folder holds before a run."""

    folder: Path
    """The folder."""
    recorded: bool
    """Whether a recording belongs to the result there."""
    overwrite: bool
    """Whether anything there may be replaced."""
    result: str
    """Its `result_name`; empty: there is none."""

    def check_recording(self) -> None:
        """Make sure that a recording may be written; raises OutputError if it would replace a file of the user's."""
        if not self.recorded and not self.overwrite and _is_there(self.folder, RECORDING):
            raise _refused(self.folder, RECORDING, "not part of the result there")


def mark_older(folder: Path) -> list[str]:
    """Mark the pages of `wayside evidence` in the folder of a result as pages of an earlier result.

    Returns their names, and those of exports and of the page of checks, which cannot be marked.
    """
    older = [path.name for path in sorted(folder.glob("signs.*")) if path.name != SIGNS.file]
    older += ["checks.html"] * (folder / "checks.html").is_file()
    for page in sorted((folder / "evidence").glob("*.html")):
        with suppress(OSError, ValueError):
            text = "" if page.is_symlink() else page.read_text("utf-8")
            if '<meta name="generator" content="wayside ' in text[:2048]:
                marked = text.replace("<body>\n", f"<body>\n{_OLDER}\n", _OLDER not in text)
                write_file(page, marked.encode(), overwrite=True)
                older.append(f"evidence/{page.name}")
    return older


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

    A result of the same log, by its fingerprint, may be replaced if each table is as `run.json` states it. `overwrite`
    replaces any result.

    Raises OutputError where the folder has a result of another log, or files that no run of wayside wrote.
    """
    tables = (*TABLES, *(table.file for table in ROADSIDE))
    standing = [name for name in (*tables, RUN_FILE) if _is_there(folder, name)]
    run = _read_run(folder)
    known = run or {}
    recorded, name = known.get("recording") is not None, result_name(known)
    found = EarlierResult(folder, recorded, overwrite, name)
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
