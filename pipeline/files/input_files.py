"""Files of the user's that are read whole: regular files only, up to a size when unpacked."""

from __future__ import annotations

import codecs
import errno
import os
import stat
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

MOST_BYTES = 1 << 30
"""Of a file read into memory, and of what Parquet unpacks to: forty million boxes with their scores."""
Where = Mapping[str, str | Collection[int]]
"""Rows to read: those that hold these texts, or one of these numbers, by column name."""
_BATCH_ROWS = 1 << 12


def open_input(path: Path) -> BinaryIO:
    """A regular file, open for reading; never waits, as the opening of a pipe does.

    Raises OSError where it cannot be read, or is no regular file; ValueError where the name holds a NUL.
    """
    opened = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    kind = os.fstat(opened).st_mode
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        os.close(opened)
        words = "a device" if stat.S_ISCHR(kind) or stat.S_ISBLK(kind) else "a pipe"
        raise OSError(errno.EINVAL, f"{words}, not a file that can be read twice", str(path))
    try:
        return os.fdopen(opened, "rb")
    except BaseException:  # a folder
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
    """The text of a regular file; raises as `read_input` and `decoded`."""
    return decoded(read_input(path))


def decoded(data: bytes) -> str:
    """The text of bytes in UTF-8, in UTF-16 with a byte order mark, or in the code page of Western Windows.

    Raises ValueError where they are no text.
    """
    try:
        marked = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = data.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252")
    if "\0" in text:
        raise ValueError("no text: it holds a NUL")
    return text


def files_below(folder: Path) -> Iterator[Path]:
    """What is no folder in a folder and those below it; raises OSError where one of these cannot be listed."""

    def refuse(error: OSError) -> None:
        raise error

    for root, _, names in os.walk(folder, onerror=refuse):
        yield from (Path(root, name) for name in names)


def read_parquet(
    path: Path, columns: Sequence[str] | None = None, where: Where | None = None
) -> pa.Table:
    """A table of a Parquet file that is not larger than `MOST_BYTES` when unpacked.

    Batches are read in this thread: `pyarrow.parquet.read_table` reads in threads of Arrow's own, which sometimes abort
    a process that ends right after them (github.com/apache/arrow/issues/34314). Filters by an expression and
    `pre_buffer` do the same.

    Parameters
    ----------
    path, columns
        The file, and the columns to read; None: all.
    where
        The rows; its columns need not be among `columns`.

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
    for name, held in where.items():
        column = table.column(name)
        kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
        values = pa.array([held] if isinstance(held, str) else sorted(held), kind)
        table = table.filter(pc.is_in(column.cast(kind), values))
    return table
