"""The process as the system sees it: signals that end it, and output that nobody reads."""

import codecs
import errno
import io
import os
import signal
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from wayside.pipeline.files.visible_text import visible_lines
from wayside.pipeline.files.writing import UNWRITABLE, not_written
from wayside.schemas.errors import InputError, UsageError, WaysideError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_ENDING_SIGNALS = ("SIGTERM", "SIGHUP")
_NO_NAMES = (errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR)
"""What a system call says of a path that can name no file."""
_STREAMS = ("stdout", "stderr")
_PLAIN = "wayside.plain"
_PLAIN_TEXTS = {"±": "+-", "°": " deg", "…": "..."}
"""What stands for a character that the encoding of a stream does not have; a question mark for any other."""


def interrupt_on_signals() -> None:
    """Treat signals that ask the process to end as Ctrl-C, so that it leaves nothing half made.

    A signal that the caller has it ignore, as `nohup` does, stays ignored.
    """
    for name in _ENDING_SIGNALS:
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


def open_standard_streams() -> None:
    """Let what nobody reads go: a pipe that its reader has closed is no fault of the work, nor is a closed stream.

    A character that the encoding of a stream does not have is written in plain ones.
    """
    codecs.register_error(_PLAIN, _in_plain_characters)
    for name in _STREAMS:
        stream = getattr(sys, name)
        if stream is None:  # closed by the caller
            setattr(sys, name, _nowhere())
            continue
        try:
            number = stream.fileno()
        except (OSError, ValueError, AttributeError):  # replaced by something that is no file
            continue
        raw = io.BufferedWriter(_Pipe(number, "wb", closefd=False))
        at_once = getattr(stream, "write_through", False)  # PYTHONUNBUFFERED
        lines = name == "stderr" or stream.isatty() or at_once
        setattr(sys, name, _Text(raw, stream.encoding, _PLAIN, line_buffering=lines))


def in_words(error: OSError) -> WaysideError:
    """What a system call says, wherever it comes up; the error itself where it says nothing of a file."""
    if error.errno in UNWRITABLE:
        target = Path(error.filename or "output")
        return not_written(target, error, "the output", "write elsewhere")
    if error.filename is None:
        raise error
    found = str(error.filename)
    shown = found if len(found) <= 80 else f"{found[:40]}...{found[-20:]} ({len(found)} long)"
    if error.errno in _NO_NAMES:
        return UsageError(f"{shown} is not a path: {error.strerror}. Correct the name.")
    return InputError(
        f"{shown} cannot be read: {error.strerror}; check the permissions of it and of the folders it lies in"
    )


def report_error(error: WaysideError, *, debug: bool) -> int:
    """Say what is wrong on stderr; the exit status. A traceback is for a fault of wayside itself, or `debug`."""
    with suppress(OSError):  # nobody can be told
        if debug or error.exit_status == 1:
            traceback.print_exc()
        print(visible_lines(f"wayside: {error}"), file=sys.stderr, flush=True)
    return error.exit_status


def flush_standard_streams() -> None:
    """Write what waits; raises OSError where the disk that it goes to is full."""
    for name in _STREAMS:
        getattr(sys, name).flush()


def silence_standard_streams() -> None:
    """Drop what waits and cannot be written, so that the end of the interpreter does not complain about it again."""
    for name in _STREAMS:
        try:
            getattr(sys, name).flush()
        except OSError:
            setattr(sys, name, _nowhere())


def _in_plain_characters(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    unknown = error.object[error.start : error.end]
    return "".join(_PLAIN_TEXTS.get(character, "?") for character in unknown), error.end


def _nowhere() -> io.TextIOWrapper:
    return open(os.devnull, "w", encoding="utf-8")


class _Text(io.TextIOWrapper):
    """Keeps the encoding it has: Click writes UTF-8 to streams in ASCII, which it takes for an oversight."""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Another name of ASCII than the one that Click looks for."""
        known = super().encoding
        return "us-plain" if codecs.lookup(known).name == "ascii" else known


class _Pipe(io.FileIO):
    """Takes everything, also where the reader has gone."""

    def write(self, data: "ReadableBuffer", /) -> int:
        """Write; how many bytes were taken."""
        with suppress(BrokenPipeError):
            return super().write(data)
        return memoryview(data).nbytes
