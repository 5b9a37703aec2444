"""The Arrow schemas, and the page of docs/ that describes them."""

import json
from itertools import groupby
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wayside.schemas.detections import VERDICT_WORDS
from wayside.schemas.frame import FRAME_STATUS_WORDS
from wayside.schemas.tables import (
    CHECKS,
    MOTION_SOURCES,
    SCHEMA_VERSION,
    SIGN_STATUSES,
    Column,
    Table,
)
from wayside.schemas.tables import TABLES as OF_A_RUN

TABLES = (*OF_A_RUN, CHECKS)

PAGE = Path(__file__).parents[2] / "docs" / "tables.md"
INTRODUCTION = """# The tables of a result

`wayside run LOG -o OUT` writes three Parquet files, and three more with `--roadside`. Columns are never renamed; new
ones may be added. Null means unknown, never 0. Field metadata holds units and meanings.

The world frame is the frame of the log's poses. With fixes only it is east, north, up from the first fix. Without
either, the origin is the first used camera, with x forward, y left and z up. The camera frame is x right, y down, z
forward. Pixel centres lie at integers; boxes are half open.

`covariance` and `sigma_along_m` to `sigma_up_m` are relative to the nearby cameras. `sigma_east_m`, `sigma_north_m`
and `sigma_alt_m` describe the position on the globe and contain the error common to all fixes. `run.json` lists
excluded poses and fixes, a time offset and long gaps under `notes`.
"""


def page() -> str:
    parts = [INTRODUCTION]
    for table in TABLES:
        parts.append(
            f"\n## {table.file}\n\n{table.words}\n\n| column | type | unit | meaning |\n| --- | --- | --- | --- |\n"
        )
        for (kind, unit, words), columns in groupby(table.columns, cells):
            names = ", ".join(f"`{column.name}`" for column in columns)
            parts.append(f"| {names} | {kind} | {unit} | {words} |\n")
    for title, words in (
        ("Values of `status` in signs.parquet", SIGN_STATUSES),
        ("Values of `status` in frames.parquet", FRAME_STATUS_WORDS),
        ("Values of `verdict`", VERDICT_WORDS),
        ("Values of `motion_source`", MOTION_SOURCES),
    ):
        parts.append(f"\n## {title}\n\n| value | meaning |\n| --- | --- |\n")
        parts.extend(f"| `{name}` | {meaning} |\n" for name, meaning in words.items())
    return "".join(parts)


def cells(column: Column) -> tuple[str, str, str]:
    """Type, unit and meaning of a column: neighbours that have the same share a row."""
    null = ", may be null" if column.nullable else ""
    return f"{type_words(column.type)}{null}", column.unit, column.words


def type_words(kind: pa.DataType) -> str:
    if pa.types.is_dictionary(kind):
        return "dictionary"
    if pa.types.is_fixed_size_list(kind):
        return f"list of {kind.list_size} {type_words(kind.value_type)}"
    return {"float": "float32", "double": "float64"}.get(str(kind), str(kind))


def test_the_page_of_docs_describes_every_column_as_it_is() -> None:
    assert PAGE.read_text() == page(), "docs/tables.md: run this file as a script to update it"


@pytest.mark.parametrize("table", TABLES, ids=lambda t: t.name)
def test_a_schema_survives_a_parquet_file_whole(table: Table, tmp_path: Path) -> None:
    pq.write_table(table.schema.empty_table(), tmp_path / table.file)
    read = pq.read_schema(tmp_path / table.file)
    assert read.equals(table.schema, check_metadata=True)
    assert json.loads(read.metadata[b"wayside"]) == {
        "table": table.name,
        "schema_version": SCHEMA_VERSION,
    }


@pytest.mark.parametrize("table", TABLES, ids=lambda t: t.name)
def test_columns_have_unique_names_the_unit_these_end_in_and_values_if_choices(
    table: Table,
) -> None:
    names = [column.name for column in table.columns]
    assert len(set(names)) == len(names)
    for column in table.columns:
        assert column.words
        suffix = column.name.rsplit("_", 1)[-1]
        if suffix in ("m", "px", "deg", "ns") and column.name != suffix:
            assert column.unit == suffix, column.name
        assert bool(column.values) == pa.types.is_dictionary(column.type), column.name


if __name__ == "__main__":
    PAGE.write_text(page())
