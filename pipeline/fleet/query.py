"""Questions in SQL about an inventory, answered by DuckDB."""

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import pyarrow as pa

from wayside.pipeline.files.parsing import FORMULA, guarded
from wayside.pipeline.fleet.folders import CELL, merged_parts, open_inventory
from wayside.pipeline.fleet.manifest import DRIVES, Manifest
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.inventory_tables import CHANGES
from wayside.schemas.tables import CHECKS, ROADSIDE, TABLES

try:
    import duckdb
except ImportError as error:
    raise UsageError(
        f"wayside query: DuckDB cannot be loaded: {error}. Install it with `pip install 'wayside[query]'`."
    ) from error

MERGED_VIEWS = ("panels", "supports", "sightings", "changes")
DRIVE_VIEWS = {table.name: table.file for table in (*TABLES, CHECKS)}
LOGS_VIEW = "logs"
VIEWS = (*MERGED_VIEWS, *DRIVE_VIEWS, LOGS_VIEW)
_WRITTEN_BY = {
    CHANGES.name: "`wayside changes` compares surveys and writes them",
    CHECKS.name: "`wayside check` compares signs with rules and writes them",
    **{table.name: "no drive was run with the setting `roadside.on`" for table in ROADSIDE},
}
FORMATS = {"csv": "csv, header", "json": "json, array true", "parquet": "parquet"}
"""What an answer is written as, and how DuckDB calls it."""


def first_rows(inventory: Path, sql: str, count: int) -> tuple[list[str], list[list[str | None]]]:
    """Names of the columns of an answer and its first rows as text; parameters and errors as of `write_answer`."""
    with _prepared(inventory, sql) as (connection, question):
        names = [name for name, _ in _columns(connection, question)]
        text = connection.sql(
            f"SELECT CAST(COLUMNS(*) AS VARCHAR) FROM ({question}\n) LIMIT {count}"
        )
        return names, [list(row) for row in text.fetchall()]


def write_answer(inventory: Path, sql: str, stream: BinaryIO, kind: str) -> None:
    """Write the answer to one question, an SQL statement that reads, as one of `FORMATS`.

    Views of the merged inventory: `panels`, `supports`, `sightings` and `changes`. Views of its drives: their tables
    and `checks`, with the name of the drive in the column `drive`. `logs` is the entry of each log in `fleet.json`.
    Nothing is changed, and nothing is fetched from elsewhere. Raises UsageError where the statement cannot be answered,
    and InputError where the folder is no inventory, or lacks what is asked for.
    """
    with _prepared(inventory, sql) as (connection, question), TemporaryDirectory() as scratch:
        file = Path(scratch) / "answer"
        if kind == "csv":
            question = _without_formulas(connection, question)
        into = f"{_quoted(file)} (FORMAT {FORMATS[kind]})"
        connection.execute(f"COPY (FROM ({question}\n)) TO {into}")
        with file.open("rb") as answer:
            shutil.copyfileobj(answer, stream)


@contextmanager
def _prepared(inventory: Path, sql: str) -> Iterator[tuple[duckdb.DuckDBPyConnection, str]]:
    """A connection with the views that a statement asks for, and the bare statement."""
    manifest = open_inventory(inventory)
    offline: Any = {
        "autoinstall_known_extensions": False,
        "autoload_known_extensions": False,
        "lock_configuration": True,  # logs and profiles would go into files
        "python_enable_replacements": False,
    }
    lacking: list[str] = []
    with duckdb.connect(":memory:", config=offline) as connection:
        try:
            statements = connection.extract_statements(sql)
            if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
                raise UsageError(
                    f"{sql!r} is not a single read-only statement. Write one SELECT, FROM, DESCRIBE or SUMMARIZE."
                )
            asked = set(re.findall(r"\w+", sql.lower()))  # words that may be views
            for view in (name for name in VIEWS if name in asked):
                if not _create_view(connection, view, inventory, manifest):
                    lacking.append(view)
            yield connection, statements[0].query.strip().rstrip(";")
        except duckdb.Error as error:
            if lacking and isinstance(error, duckdb.CatalogException):
                nothing = "nothing is merged yet, or no drive has satellite fixes"
                why = _WRITTEN_BY.get(lacking[0], nothing)
                raise InputError(
                    f"{inventory}: there are no {', '.join(lacking)}: {why}"
                ) from error
            raise UsageError(
                f"the query failed: {error}\n"
                f'views: {", ".join(VIEWS)}; "DESCRIBE panels" lists the columns of one'
            ) from error


def _create_view(
    connection: duckdb.DuckDBPyConnection, view: str, inventory: Path, manifest: Manifest
) -> bool:
    """Make one view; whether there are files of it. To open those of all views takes long in a large inventory."""
    if view == LOGS_VIEW:
        rows = [asdict(entry) for _, entry in sorted(manifest.logs.items())]
        connection.register(view, pa.Table.from_pylist(rows))
        return True
    folder = "parse_path(filename, 'forward_slash')[-2]"
    if view in DRIVE_VIEWS:
        drives = [inventory / DRIVES / entry.name for entry in manifest.done()]
        files = [file for drive in drives if (file := drive / DRIVE_VIEWS[view]).exists()]
        columns = f"{folder} AS drive, * EXCLUDE filename"
    elif view == CHANGES.name:
        files = [file for file in [inventory / CHANGES.file] if file.exists()]
        columns = "* EXCLUDE filename"
    else:
        files = merged_parts(inventory, view)
        columns = f"* EXCLUDE filename, {folder}[{len(CELL) + 1}:] AS cell"
    if not files:
        return False
    listed = ", ".join(_quoted(_literal(file)) for file in files)
    connection.execute(
        f"CREATE VIEW {view} AS SELECT {columns} FROM read_parquet([{listed}], union_by_name = true, "
        "filename = true, hive_partitioning = false)"
    )
    return True


def _literal(file: Path) -> str:
    """A path as DuckDB opens it, which takes `*`, `?` and `[` for a pattern, and then a backslash for a slash, too."""
    text = str(file)
    if "\\" in text and re.search(r"[*?[]", text):
        raise InputError(
            f"{file}: DuckDB cannot open a path with both a backslash and one of * ? [; rename one of its folders"
        )
    return re.sub(r"[*?[]", r"[\g<0>]", text)


def _columns(connection: duckdb.DuckDBPyConnection, question: str) -> list[tuple[str, str]]:
    """Name and type of the columns of an answer.

    A question is run inside of another one only: by itself one that reads may begin with a COPY that writes.
    """
    described = connection.sql(f"FROM ({question}\n) LIMIT 0").description
    return [(str(name), str(kind)) for name, kind, *_ in described]


def _without_formulas(connection: duckdb.DuckDBPyConnection, question: str) -> str:
    """The same question with its texts, names of columns too, as `guarded` gives them."""
    columns, listed = _columns(connection, question), []
    for number, (name, kind) in enumerate(columns):
        value = f"c{number}"
        if kind in ("VARCHAR", "STRING") or re.fullmatch(r"ENUM\(.*\)", kind, re.DOTALL):
            value = f"CAST({value} AS VARCHAR)"
            mark = f"regexp_matches({value}, {_quoted(FORMULA)})"
            value = f"CASE WHEN {mark} THEN chr(39) || {value} ELSE {value} END"
        listed.append(f'{value} AS "{guarded(name).replace(chr(34), 2 * chr(34))}"')
    names = ", ".join(f"c{number}" for number in range(len(columns)))
    return f"SELECT {', '.join(listed)} FROM ({question}\n) AS answer({names})"


def _quoted(text: object) -> str:
    return "'" + str(text).replace("'", "''") + "'"
