"""Recordings that are read as logs: MCAP files and bags of them as they are, other ROS bags joined to a log first."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

from wayside.pipeline.reading.parts import bag_parts, is_bag, is_mcap
from wayside.pipeline.results.earlier_result import log_fingerprint
from wayside.schemas.errors import InputError, OutputError

_LAYOUT = "1"
"""Of the joined logs: other ones have other names."""


def joined_log(path: Path) -> Path | None:
    """Where the log of a ROS bag that is not of MCAP is kept: in the user's cache, named by the bag's content.

    None for all else, which is read as it is.
    """
    if path.is_dir():
        if not is_bag(path) or all(is_mcap(part) for part in bag_parts(path)):
            return None
    elif path.suffix != ".bag" or not path.is_file():
        return None
    digest = hashlib.sha256(f"{_LAYOUT} {log_fingerprint(path)}".encode()).hexdigest()
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "wayside" / "bags" / digest[:16] / f"{path.stem}.mcap"


def readable_log(path: Path, tell: Callable[[str], None]) -> Path:
    """What is to be read of a recording: itself, or the log that a ROS bag was joined to, now or before.

    Parameters
    ----------
    path
        An MCAP file, a ROS 2 bag directory or a ROS 1 bag.
    tell
        Called with where the log of a bag lies, and what of the bag was lost on the way.

    Raises
    ------
    InputError
        A bag cannot be read.
    OutputError
        The log of a bag cannot be written.
    """
    log = joined_log(path)
    if log is None:
        return path
    if log.is_file():
        tell(f"{path}: read from {log}, which was made of it before")
        return log
    from wayside.pipeline.logs.joining import join_logs

    tell(
        f"{path}: joined first to {log}, which later commands read, too; "
        f"`wayside join {path} -o drive.mcap` puts it where you want it"
    )
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        joined = join_logs([path], log)
    except (OSError, OutputError) as error:
        raise OutputError(
            f"{path}: joining it to {log} failed ({error}). Join it elsewhere with `wayside join {path} -o "
            "drive.mcap`, or set XDG_CACHE_HOME."
        ) from error
    except InputError:
        log.parent.rmdir()
        raise
    for words in joined.lost:
        tell(f"lost: {words}")
    return log
