"""Parts of one drive, and ROS bags, to one log: by `wayside join`, or by any command that is given such a bag."""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.writer import CompressionType, Writer

from wayside.pipeline.files.writing import whole_file
from wayside.pipeline.reading.layout import Channel
from wayside.pipeline.reading.messages import ROS_TYPES
from wayside.pipeline.reading.parts import bag_parts, is_bag, is_mcap
from wayside.pipeline.reading.records import Attachment, Metadata, ScanReport, scan
from wayside.pipeline.results.result import log_fingerprint
from wayside.schemas.errors import InputError, OutputError

_BAG_VERSION = 9
_LAYOUT = "1"
"""Version of the joined logs in the cache, in their names."""


class JoinedLog(NamedTuple):
    """A joined log: its parts in order, numbers of messages and topics, and what could not be read."""

    parts: tuple[Path, ...]
    messages: int
    topics: int
    lost: tuple[str, ...]


def join_logs(paths: list[Path], out: Path, *, overwrite: bool = False) -> JoinedLog:
    """Write the messages of several parts, in the order of the drive, to one MCAP log.

    `paths`: MCAP files, ROS 2 bag directories (`metadata.yaml` with MCAP or SQLite parts, split or compressed), ROS 1
    bags. All messages of MCAP files are kept as they are, with metadata and attachments. Of other bags the message
    types that are understood are kept; those of ROS 1 become their ROS 2 counterparts (cdr). `overwrite`: replace a
    file of that name that is not this very log. Raises InputError where a part cannot be read or holds no message, and
    OutputError.
    """
    beside = out.parent if out.parent.is_dir() else None  # it has room for the result
    parts: list[Path] = []
    lost: list[str] = []
    with (
        tempfile.TemporaryDirectory(prefix=".wayside-join-", dir=beside) as scratch,
        whole_file(out, overwrite=overwrite) as stream,
    ):
        writer = _Joiner(stream)
        for number, path in enumerate(paths):
            for file in _as_mcap(path, Path(scratch) / str(number)):
                made = file.is_relative_to(scratch)
                shown, report, before = path if made else file, ScanReport(), writer.messages
                writer.add(file, report)
                if writer.messages == before:
                    raise InputError(f"{shown}: no message can be used. Leave it out.")
                parts.append(shown)
                lost += [f"{shown.name}: {problem}" for problem in report.problems]
                if made:
                    file.unlink()
        writer.finish()
    topics = writer.channel.cache_info().currsize
    return JoinedLog(tuple(parts), writer.messages, topics, tuple(lost))


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
    """The file to read for a recording: itself, or the log that a ROS bag is converted to, now or earlier.

    `tell`: called with the path of a bag's log, and with what was lost of the bag. Raises InputError where a
    bag cannot be read, and OutputError where its log cannot be written.
    """
    log = joined_log(path)
    if log is None:
        return path
    if log.is_file():
        tell(f"{path}: read from {log}, which was made from it earlier")
        return log
    tell(
        f"{path}: joined to {log} first, which later commands use again; `wayside join {path} -o drive.mcap` "
        "writes it where you want"
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


def _as_mcap(path: Path, scratch: Path) -> list[Path]:
    """The MCAP files of a part: itself, those of its bag, or what it was converted to in a scratch folder."""
    try:
        path.stat()
    except OSError as error:
        raise _no_part(path, f": {error.strerror}") from error
    parts = bag_parts(path) if path.is_dir() else [path]
    if all(is_mcap(part) for part in parts):
        return parts
    ros1 = path.suffix == ".bag"
    if not path.is_dir() and not (ros1 and path.is_file()):
        raise _no_part(path, "")
    from rosbags.convert import ConverterError
    from rosbags.convert.converter import convert
    from rosbags.typesys import Stores, get_typestore

    ros2_types = get_typestore(Stores.ROS2_HUMBLE)
    try:
        convert(
            [path],
            scratch,
            dst_storage="mcap",
            dst_version=_BAG_VERSION,
            compress=None,
            compress_mode="file",
            default_typestore=None if ros1 else ros2_types,
            typestore=ros2_types if ros1 else None,
            exclude_topics=(),
            include_topics=(),
            exclude_msgtypes=(),
            include_msgtypes=ROS_TYPES,
        )
    except (ConverterError, FileNotFoundError) as error:
        raise InputError(
            f"{path}: the ROS bag cannot be read: {error}. Repair it with "
            f"`{'rosbag reindex' if ros1 else 'ros2 bag reindex'}`."
        ) from error
    return sorted(scratch.glob("*.mcap"))


def _no_part(path: Path, found: str) -> InputError:
    return InputError(
        f"{path}: this is not an MCAP file, a ROS 2 bag directory or a ROS 1 bag{found}. For a ROS 2 bag, give "
        "the directory."
    )


class _Joiner:
    """Writes messages of several logs to one; channels of the same topic and schema become one."""

    def __init__(self, stream: BinaryIO) -> None:
        self._writer = Writer(stream, compression=CompressionType.LZ4)
        self._writer.start(library="wayside")
        self._schema = cache(self._writer.register_schema)
        self.channel = cache(self._writer.register_channel)
        self.messages = 0

    def add(self, part: Path, report: ScanReport) -> None:
        """Append all of a log, in the order of its file."""
        writer = self._writer
        for record in scan(part, report):
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Attachment):
                writer.add_attachment(0, 0, record.name, record.media_type, record.data)
            else:
                channel, time = self._channel(record.channel), record.log_time_ns
                writer.add_message(channel, time, bytes(record.data), time, record.sequence)
                self.messages += 1

    def finish(self) -> None:
        """Write the summary."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _channel(self, channel: Channel) -> int:
        one = channel.schema
        schema = 0 if one is None else self._schema(one.name, one.encoding, one.data)
        return self.channel(channel.topic, channel.encoding, schema)
