"""Reading back a folder that `wayside run` has written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import UnionType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from wayside.pipeline.files.input_files import Where, read_input_text, read_parquet
from wayside.pipeline.files.output_folder import finish_replacement
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.reading.parts import is_bag
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.settings import ReadSettings
from wayside.schemas.tables import Table

RUN_FILE = "run.json"
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
    out: Path,
    table: Table,
    columns: Sequence[str] | None = None,
    where: Where | None = None,
) -> pa.Table:
    """One table of a result folder.

    Parameters
    ----------
    out, table
        Folder written by `wayside run`; which of its tables.
    columns
        Those to read; None: all. Columns that an earlier version did not write come as null.
    where
        The rows; its columns need not be among `columns`.

    Raises InputError where the folder is no result folder, or the file is damaged or something else: a column is of
    another type, or lacks values that every row must have.
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
