"""How every command writes a file: under another name in the same folder, synced, then renamed.

The error messages are here too. A file appears under its name when it is whole. An existing file is replaced only where
wayside recognises it as its own, or with `overwrite`.
"""

import errno
import filecmp
import json
import os
import re
import secrets
import stat
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from io import BufferedWriter
from pathlib import Path
from typing import Any, BinaryIO

from filelock import FileLock, Timeout

from wayside.pipeline.files.parsing import parse_json
from wayside.schemas.errors import OutputError

PART = ".wayside-part"
"""Scratch folder of a set of files, and the end of the name of a scratch file."""
_NEW_FILE = os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
_ADVICE = {
    errno.ENOSPC: "free some space, or",
    errno.EDQUOT: "the quota is used up: free some space, or",
    errno.EFBIG: "the file would be larger than is permitted here:",
    errno.EIO: "the disk reports a fault: check it, or",
}
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP)
UNWRITABLE = (*_ADVICE, errno.EROFS)
"""Messages of system calls for an output that cannot be written."""
IsOwn = Callable[[Path], bool]


def not_written(
    path: Path,
    error: OSError,
    content: str = "the result",
    instead: str = "choose another folder with -o",
) -> OutputError:
    """The error for a person where `path`, or the scratch folder in it, cannot be written."""
    path = path.parent if path.name == PART else path
    advice = f"{_ADVICE.get(error.errno or 0, '')} {instead}".strip()
    advice = advice[:1].upper() + advice[1:]
    return OutputError(f"{path}: {content} cannot be written: {error.strerror or error}. {advice}.")


def create(path: Path) -> BufferedWriter:
    """A new file, open for writing; raises OSError if the path exists, also as a symbolic link."""
    return os.fdopen(os.open(path, os.O_RDWR | _NEW_FILE, 0o666), "wb")


def sync(path: Path) -> None:
    """Return when a file, or the names in a folder, are on the disk; raises OSError where it did not take them."""
    is_folder = path.is_dir()
    if is_folder and os.name == "nt":
        return  # Windows opens no folder
    opened = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(opened)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a file system that has no such call
            raise
    finally:
        os.close(opened)


def take_lock(path: Path, patience_s: float = 0.0) -> FileLock | None:
    """Lock a file, made where it is missing; None where another process holds it for so long.

    A file system without locks keeps nobody apart. The holder removes the file before the lock is given back.
    """
    held = FileLock(path, mode=0o666, thread_local=False)
    try:
        held.acquire(timeout=patience_s)
    except Timeout:
        return None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    return held


def give_back(held: FileLock) -> None:
    """Remove a file that `take_lock` has locked, and release the lock."""
    with suppress(OSError):
        Path(held.lock_file).unlink()
    held.release()


def refuse(path: Path, found: str) -> OutputError:
    """The error if a file of the user is in the way."""
    return OutputError(
        f"{path}: the name is taken by {found}. Choose another name, or replace it with --overwrite."
    )


def require_free(
    path: Path, *, is_own: IsOwn = lambda path: False, overwrite: bool = False
) -> None:
    """Refuse before long work what `whole_file` would refuse after it (OutputError): a file of the user."""
    if path.is_file() and not is_stream(path) and not overwrite and not is_own(path):
        raise refuse(path, "another file")


@contextmanager
def whole_file(
    path: Path, *, is_own: IsOwn = lambda path: False, overwrite: bool = False
) -> Iterator[BinaryIO]:
    """A file to write, which appears under its name, synced, when the block ends without an error.

    Devices and pipes are written as they are. The same bytes once more are never refused.

    `path`: where it goes; a symbolic link stays and what it points to is replaced. `is_own`: whether an existing file
    was written by wayside, and may be replaced. `overwrite`: replace any existing file. Raises OutputError where it
    cannot be written, or would replace a file of the user.
    """
    require_local(path)
    try:
        if is_stream(path):
            with path.open("wb") as stream:
                yield stream
            return
        target = resolved(path)
        if target.is_dir():
            raise OutputError(f"{path}: this is a folder. Name a file in it.")
        replaced = overwrite or not target.exists() or is_own(target)
        scratch = target.with_name(f".{target.name}.{secrets.token_hex(4)}{PART}")
        with ExitStack() as ended:
            stream = create(scratch)
            ended.callback(_remove, stream, scratch)
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
            if not replaced and not filecmp.cmp(scratch, target, shallow=False):
                raise refuse(path, "another file")
            os.replace(scratch, target)
        sync(target.parent)
    except OSError as error:
        raise not_written(path, error, "the file", "name another file") from error


def _remove(stream: BinaryIO, scratch: Path) -> None:
    """Remove a scratch file that is still there, then close it: what waits in its buffer may not fit on the disk."""
    scratch.unlink(missing_ok=True)
    with suppress(OSError):
        stream.close()


def write_file(
    path: Path, content: bytes, *, is_own: IsOwn = lambda path: False, overwrite: bool = False
) -> None:
    """Write a file at once. Takes and raises the same as `whole_file`."""
    with whole_file(path, is_own=is_own, overwrite=overwrite) as stream:
        stream.write(content)


def write_json(
    path: Path, content: Mapping[str, Any], own_keys: Collection[str], *, overwrite: bool = False
) -> None:
    """Write figures as JSON, also over an earlier file with all of `own_keys`; raises as `whole_file`."""
    text = json.dumps(content, indent=1) + "\n"
    write_file(path, text.encode(), is_own=holding(own_keys), overwrite=overwrite)


def holding(keys: Collection[str]) -> IsOwn:
    """Whether a file is JSON with all these keys."""

    def is_own(earlier: Path) -> bool:
        try:
            found = parse_json(earlier.read_text("utf-8"))
        except (OSError, ValueError):
            return False
        return isinstance(found, dict) and found.keys() >= set(keys)

    return is_own


def require_local(path: Path) -> None:
    """Raise OutputError for an address such as s3://bucket, of which the system would make a folder `s3:`."""
    if re.fullmatch(r"[a-z][a-z0-9+.-]+:", path.parts[0] if path.parts else "", re.IGNORECASE):
        raise OutputError(
            f"{path}: this is an address, and results are written to local files only. Write to a folder, and copy it."
        )


def resolved(path: Path) -> Path:
    """Where a path leads, absolute; raises OSError for a link that leads to itself."""
    try:
        return path.resolve()
    except RuntimeError as error:  # what Python says before 3.13
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path)) from error


def is_stream(path: Path) -> bool:
    """Whether a path is a device, a pipe or an open file of this process, which cannot be replaced."""
    if path.parts[:2] in (("/", "dev"), ("/", "proc")):
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))
