"""The files of a log: one MCAP file, or the parts of a ROS 2 bag directory; and what reading them found."""

from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path

from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_yaml
from wayside.schemas.errors import InputError

BAG_METADATA = "metadata.yaml"
"""The file of a ROS 2 bag directory that lists its parts."""
MOST_PROBLEMS = 200
"""Problems kept in words; further ones are counted only, so that a hopeless file cannot fill the memory."""


@dataclass(frozen=True, slots=True)
class LogParts:
    """MCAP files that are read one after the other as one log; `starts`: where each begins, bytes from its start."""

    files: tuple[Path, ...]
    starts: tuple[int, ...]
    size: int

    def at(self, offset: int) -> tuple[Path, int]:
        """The file in which an offset of the log lies, and the offset there."""
        number = bisect_right(self.starts, offset) - 1
        return self.files[number], offset - self.starts[number]


def log_parts(path: Path) -> LogParts:
    """The files of a log and their sizes; a file that is not there has none.

    Raises InputError as `bag_parts`, and where its parts are not MCAP files.
    """
    files = bag_parts(path) if path.is_dir() else [path]
    if len(files) > 1 and not all(is_mcap(file) for file in files):
        raise InputError(
            f"{path}: the ROS 2 bag holds {files[0].name} instead of MCAP parts. Make a log of it with `wayside join "
            f"{path} -o drive.mcap`."
        )
    sizes = [file.stat().st_size if file.exists() else 0 for file in files]
    return LogParts(tuple(files), (0, *accumulate(sizes[:-1])), sum(sizes))


def is_mcap(path: Path) -> bool:
    """Whether a file is MCAP by its name."""
    return path.suffix == ".mcap"


def is_bag(path: Path) -> bool:
    """Whether a directory has the list of parts that a ROS 2 bag has."""
    return (path / BAG_METADATA).is_file()


def bag_parts(folder: Path) -> list[Path]:
    """Files of a ROS 2 bag directory in their order.

    Raises InputError if a part is missing or this is another directory.
    """
    file = folder / BAG_METADATA
    if not file.exists():
        raise InputError(
            f"{folder}: this folder is not a ROS 2 bag, as it holds no {BAG_METADATA}. Give an MCAP file of it, write "
            f"the list with `ros2 bag reindex`, or make a log of images with `wayside import {folder}`."
        )
    try:
        content = parse_yaml(read_input_text(file))
        listed = content["rosbag2_bagfile_information"]["relative_file_paths"]
        parts = [folder / Path(str(name)).name for name in listed]
    except (OSError, *CONTENT_FAULTS) as error:
        raise InputError(
            f"{folder}: the {BAG_METADATA} of the ROS 2 bag directory cannot be read ({type(error).__name__}). Give "
            "its parts one by one, or repair it with `ros2 bag reindex`."
        ) from error
    missing = [part.name for part in parts if not part.is_file()]
    if missing or not parts:
        absent = ", ".join(missing) or "part listed"
        raise InputError(
            f"{folder}: there is no {absent}, which {BAG_METADATA} lists as a part. Copy the whole directory."
        )
    return parts


@dataclass(frozen=True, slots=True)
class Problem:
    """Something in the log that could not be used, where it begins, and what it cost."""

    offset: int
    what: str
    part: str = ""
    """File of a bag in which the offset counts; empty: the log is one file."""

    def __str__(self) -> str:
        """One line for a person."""
        where = f"{self.part}, at byte" if self.part else "at byte"
        return f"{where} {self.offset}: {self.what}"


@dataclass(slots=True)
class ScanReport:
    """What a scan found, filled while it runs.

    `messages_stated`: how many messages the summary counts, None where it does not say or was not reached.
    `unchecked_messages`: those outside of chunks with a checksum. `unknown_records`: of kinds that are not known.
    `part`: file of a bag that is being read, empty where the log is one file.
    """

    part: str = ""
    bytes_total: int = 0
    bytes_read: int = 0
    messages: int = 0
    unchecked_messages: int = 0
    messages_stated: int | None = None
    chunks: int = 0
    lost_chunks: int = 0
    unknown_records: int = 0
    compressions: Counter[str] = field(default_factory=Counter)
    problems: list[Problem] = field(default_factory=list)
    problem_count: int = 0

    @property
    def unchecked(self) -> list[str]:
        """What may have been lost without a trace, in words."""
        notes = []
        if self.unchecked_messages:
            some = f"{self.unchecked_messages} of {self.messages} messages have"
            what = "the log has" if self.unchecked_messages == self.messages else some
            notes.append(f"{what} no checksum: damage inside messages would go unnoticed")
        if self.unknown_records:
            notes.append(f"{self.unknown_records} records of unknown kinds were skipped")
        return notes

    def add_problem(self, offset: int, what: str) -> None:
        """Count a problem and keep its words while there is room."""
        self.problem_count += 1
        if self.problem_count <= MOST_PROBLEMS:
            self.problems.append(Problem(offset, what, self.part))
        elif self.problem_count == MOST_PROBLEMS + 1:
            self.problems.append(Problem(offset, "more problems follow, not listed"))
