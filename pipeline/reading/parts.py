"""The files of a log: one MCAP file, or the parts that a ROS 2 bag directory lists."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_yaml
from wayside.schemas.errors import InputError

BAG_METADATA = "metadata.yaml"
"""The file of a ROS 2 bag directory that lists its parts."""


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
    """Whether a file is one of MCAP by its name."""
    return path.suffix == ".mcap"


def is_bag(path: Path) -> bool:
    """Whether a directory has the list of parts that a ROS 2 bag has."""
    return (path / BAG_METADATA).is_file()


def bag_parts(folder: Path) -> list[Path]:
    """Files of a ROS 2 bag directory in their order.

    Raises InputError if a part is missing or this is another directory.
    """
    file = folder / BAG_METADATA
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
