"""Files that a calibration writes: whole or not at all, and never over another without being asked to."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from wayside.schemas.errors import OutputError, UsageError


def require_free(paths: list[Path], *, overwrite: bool) -> None:
    """Refuse, before any work is done, files that are there or whose folder is not.

    Raises
    ------
    UsageError
        A file is there, and `overwrite` is False.
    OutputError
        A folder is missing.
    """
    for path in paths:
        if not path.parent.is_dir():
            raise OutputError(
                f"{path}: wanted a folder to write to, found none at {path.parent}; make it first"
            )
    taken = [str(path) for path in paths if path.exists()]
    if taken and not overwrite:
        raise UsageError(
            f"wanted new files to write, found {' and '.join(taken)}; name others, or add --overwrite"
        )


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that appears whole or not at all. Raises OutputError."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise OutputError(
            f"{path}: could not be written: {error.strerror or error}; choose another with -o"
        ) from error
