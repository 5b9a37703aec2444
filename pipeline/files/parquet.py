"""Arrow columns, and Parquet files made of them."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from wayside.pipeline.files.input_files import MOST_BYTES, open_input
from wayside.pipeline.files.writing import create
from wayside.schemas.tables import Table

Where = Mapping[str, str | Collection[int]]
"""Rows to read: those that hold these texts, or one of these numbers, by column name."""
_BATCH_ROWS = 1 << 12


@contextmanager
def parquet_file(
    file: Path | BinaryIO, schema: pa.Schema, geo: str | None = None
) -> Iterator[pq.ParquetWriter]:
    """Write a Parquet file at a path, or in a stream that its owner closes.

    Raises OSError where it cannot be written, or exists.
    """
    with ExitStack() as opened:
        stream = opened.enter_context(create(file)) if isinstance(file, Path) else file
        writer = opened.enter_context(pq.ParquetWriter(stream, schema, compression="zstd"))
        yield writer
        if geo is not None:
            writer.add_key_value_metadata({"geo": geo})


def geoparquet_metadata(signs: Sequence[dict[str, Any]]) -> str:
    """GeoParquet 1.1 metadata; without a `crs` key the coordinates are OGC:CRS84, heights ellipsoidal."""
    column: dict[str, Any] = {"encoding": "WKB", "geometry_types": ["Point Z"]}
    if placed := [row for row in signs if row["lon_deg"] is not None]:
        points = np.array([[row["lon_deg"], row["lat_deg"], row["alt_m"]] for row in placed])
        column["bbox"] = [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()]
    return json.dumps(
        {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    )


def record_batch(table: Table, values: dict[str, Any]) -> pa.RecordBatch:
    """One batch of a table from arrays or plain lists by column name; names of classes become dictionary codes."""
    arrays = []
    for column in table.columns:
        value = values[column.name]
        if not isinstance(value, pa.Array):
            if pa.types.is_dictionary(column.type):
                codes = (None if v is None else column.values.index(v) for v in value)
                numbers = pa.array(codes, pa.int8())
                value = pa.DictionaryArray.from_arrays(numbers, list(column.values))
            else:
                value = pa.array(value, column.type)
        arrays.append(value)
    return pa.record_batch(arrays, schema=table.schema)


def choice(table: Table, name: str, codes: NDArray[Any]) -> pa.DictionaryArray[Any, Any]:
    """Codes as a dictionary column; negative ones are null."""
    column = next(c for c in table.columns if c.name == name)
    signed = codes.astype(np.int8)
    indices: pa.Int8Array = pa.array(signed, pa.int8(), mask=signed < 0)
    return pa.DictionaryArray.from_arrays(indices, list(column.values))


def fixed_list(rows: NDArray[Any], width: int) -> pa.FixedSizeListArray[Any, Any]:
    """Rows (n, width) as a column of lists of that width."""
    return pa.FixedSizeListArray.from_arrays(pa.array(rows.astype(np.float32).ravel()), width)


def known(values: NDArray[Any]) -> pa.Array[Any]:
    """Numbers as a column, nan as null."""
    column: pa.Array[Any] = pa.array(values, mask=~np.isfinite(values))
    return column


def read_parquet(
    path: Path, columns: Sequence[str] | None = None, where: Where | None = None
) -> pa.Table:
    """A table of a Parquet file that is not larger than `MOST_BYTES` when unpacked.

    Batches are read in this thread: `pyarrow.parquet.read_table` reads in threads of Arrow's own, which sometimes abort
    a process that ends right after them (github.com/apache/arrow/issues/34314). Filters by an expression and
    `pre_buffer` do the same.

    `columns`: those to read; None: all. `where`: the rows; its columns need not be among `columns`.

    Raises as `open_input`; `pa.ArrowException` where it is no Parquet file, `pa.ArrowInvalid` beyond the bound or where
    a column is missing.
    """
    found, size = [], 0
    try:
        with open_input(path) as stream:
            file = pq.ParquetFile(stream, pre_buffer=False)
            schema = file.schema_arrow
            names = schema.names if columns is None else list(columns)
            read = list(dict.fromkeys((*names, *(where or {}))))
            missing = [name for name in read if name not in schema.names]
            if missing:
                listed = ", ".join(schema.names)
                raise pa.ArrowInvalid(f"it has no column {missing[0]}; its columns are {listed}")
            kept = pa.schema([schema.field(name) for name in names]).with_metadata(schema.metadata)
            found.append(kept.empty_table())
            for batch in file.iter_batches(_BATCH_ROWS, columns=read, use_threads=False):
                size += batch.nbytes
                if size > MOST_BYTES:
                    raise pa.ArrowInvalid(
                        f"Parquet that unpacks to more than {MOST_BYTES} bytes: leave rows or columns out"
                    )
                chosen = _rows(pa.Table.from_batches([batch]), where or {})
                found.append(chosen.select(names).cast(kept))
    except (OSError, pa.ArrowException):
        raise
    except (LookupError, TypeError, ValueError) as error:  # names that are no text or not unique
        raise pa.ArrowInvalid(f"{type(error).__name__}: {error}") from error
    return pa.concat_tables(found)


def _rows(table: pa.Table, where: Where) -> pa.Table:
    import pyarrow.compute as pc  # takes 10 MB, which a run does without

    for name, held in where.items():
        column = table.column(name)
        kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
        values = pa.array([held] if isinstance(held, str) else sorted(held), kind)
        table = table.filter(pc.is_in(column.cast(kind), values))
    return table
