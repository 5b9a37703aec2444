"""Files of the user's that are read whole: regular files only, and none that unpacks beyond measure."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from wayside.pipeline.json_text import CONTENT_FAULTS
from wayside.pipeline.parquet_footer import stated_columns

MOST_BYTES = 1 << 30
"""Of a file read into memory, and of what Parquet unpacks to: forty million boxes with their scores."""
_TEXTS = (pa.string(), pa.binary(), pa.large_string(), pa.large_binary())
_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def open_input(path: Path) -> BinaryIO:
    """A regular file, open for reading; never waits, as the opening of a pipe does.

    Raises
    ------
    OSError
        It cannot be read, or is a folder, pipe, socket or device.
    ValueError
        The name holds a NUL.
    """
    opened = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        kind = stat.S_IFMT(os.fstat(opened).st_mode)
        if kind in _KINDS:
            raise OSError(
                errno.EINVAL, f"{_KINDS[kind]}, not a file that can be read twice", str(path)
            )
        return os.fdopen(opened, "rb")
    except BaseException:
        os.close(opened)
        raise


def read_input(path: Path) -> bytes:
    """The bytes of a regular file of at most `MOST_BYTES`; raises as `open_input`, and OSError for a larger one."""
    with open_input(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > MOST_BYTES:
            raise OSError(errno.EFBIG, f"{size} bytes, more than {MOST_BYTES}", str(path))
        return stream.read()


def read_input_text(path: Path) -> str:
    """The text of a regular file in UTF-8; raises as `read_input`, and UnicodeDecodeError."""
    return read_input(path).decode("utf-8")


def read_parquet(
    path: Path, columns: Sequence[str] | None = None, filters: pc.Expression | None = None
) -> pa.Table:
    """A table of a Parquet file that is not larger than `MOST_BYTES` when unpacked.

    The bound is tested on the metadata: the bytes that it states for the columns, and the rows times the width of a
    value. Texts are read as numbers of distinct ones first, and are spelt out where that stays within the bound.

    Parameters
    ----------
    path
        The file.
    columns, filters
        As of `pyarrow.parquet.read_table`.

    Raises
    ------
    OSError, ValueError
        As `open_input`; `pa.ArrowException` where it is no Parquet file, `pa.ArrowInvalid` beyond the bound.
    """
    with open_input(path) as stream:
        try:
            return _whole_table(stream, columns, filters)
        except (OSError, pa.ArrowException):
            raise
        except CONTENT_FAULTS as error:  # names that are no text, two columns of one name
            raise pa.ArrowInvalid(f"{type(error).__name__}: {error}") from error


def _whole_table(
    stream: BinaryIO, columns: Sequence[str] | None, filters: pc.Expression | None
) -> pa.Table:
    stated = stated_columns(stream)
    _test(sum(c.bytes for c in stated if columns is None or c.name in columns))
    schema = pq.read_schema(stream)
    texts = [field.name for field in schema if field.type in _TEXTS]
    stream.seek(0)
    found = pq.read_table(
        stream,
        columns=None if columns is None else list(columns),
        filters=filters,
        read_dictionary=texts,
    )
    _test(sum(_spelt_bytes(found.column(name)) for name in found.column_names))
    for name in set(texts) & set(found.column_names):
        at = found.schema.get_field_index(name)
        field = schema.field(name)
        if found.schema.field(at).type != field.type:
            found = found.set_column(at, field, found.column(at).cast(field.type))
    return found


def _test(found: int) -> None:
    if found > MOST_BYTES:
        raise pa.ArrowInvalid(
            f"Parquet that unpacks to {found} bytes, more than {MOST_BYTES}: leave rows or columns out"
        )


def _spelt_bytes(column: pa.ChunkedArray[Any]) -> int:
    """What a column of numbered texts takes with every text spelt out; else 0."""
    total = 0
    for chunk in column.chunks:
        if isinstance(chunk, pa.DictionaryArray) and not pa.types.is_integer(chunk.type.value_type):
            texts: Any = chunk.dictionary  # of one of four types
            lengths = pc.binary_length(texts).take(chunk.indices)
            total += int(pc.sum(lengths.cast(pa.int64())).as_py() or 0)
    return total
