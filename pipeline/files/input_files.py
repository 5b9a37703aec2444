"""Files of the user's that are read whole: regular files only, up to a size when unpacked."""

import codecs
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

MOST_BYTES = 1 << 30
"""Of a file read into memory, and of what Parquet unpacks to: forty million boxes with their scores."""


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

    Raises ValueError where they are not text.
    """
    try:
        marked = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = data.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252")
    if "\0" in text:
        raise ValueError("not text: it holds a NUL")
    return text


def files_below(folder: Path) -> Iterator[Path]:
    """All files in a folder and the folders below; raises OSError where a folder cannot be listed."""

    def refuse(error: OSError) -> None:
        raise error

    for root, _, names in os.walk(folder, onerror=refuse):
        yield from (Path(root, name) for name in names)
