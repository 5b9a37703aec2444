"""Parts of one drive, and ROS bags, to one log (`wayside join`)."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType, Writer
from rosbags.convert import ConverterError
from rosbags.convert.converter import convert
from rosbags.typesys import Stores, get_typestore

from wayside.pipeline.files.writing import whole_file
from wayside.pipeline.reading.layout import Channel
from wayside.pipeline.reading.messages import ROS_TYPES
from wayside.pipeline.reading.parts import bag_parts, is_mcap
from wayside.pipeline.reading.records import Attachment, Metadata, ScanReport, scan
from wayside.schemas.errors import InputError, UsageError

_BAG_VERSION = 9


@dataclass(frozen=True, slots=True)
class JoinedLog:
    """What became one log: its parts in order, messages and topics; `lost`: what of the parts was not readable."""

    parts: tuple[Path, ...]
    messages: int
    topics: int
    lost: tuple[str, ...]


def join_logs(paths: list[Path], out: Path, *, overwrite: bool = False) -> JoinedLog:
    """Write the messages of several parts, one after the other, to one MCAP log.

    Parameters
    ----------
    paths
        MCAP files in the order of the drive; ROS 2 bag directories (`metadata.yaml` with MCAP or SQLite parts, split or
        compressed); ROS 1 bags. Of MCAP every message is kept as it is, with metadata and attachments. Of other bags
        the message types that are understood are kept, those of ROS 1 as their ROS 2 counterparts (cdr).
    out
        The MCAP file to write; it appears when it is complete.
    overwrite
        Replace a file of that name that is not this very log.

    Raises
    ------
    UsageError
        There is no path.
    InputError
        A part cannot be read, or holds no message.
    OutputError
        The log cannot be written, or another file of that name stands there.
    """
    if not paths:
        raise UsageError("no parts to join are given. Give MCAP files or ROS bags.")
    beside = out.parent if out.parent.is_dir() else None  # it has room for the result
    with (
        tempfile.TemporaryDirectory(prefix=".wayside-join-", dir=beside) as scratch,
        whole_file(out, overwrite=overwrite) as stream,
    ):
        return _join(paths, stream, Path(scratch))


def _join(paths: list[Path], stream: BinaryIO, scratch: Path) -> JoinedLog:
    parts: list[Path] = []
    lost: list[str] = []
    writer = _Joiner(stream)
    for number, path in enumerate(paths):
        with _as_mcap(path, scratch / str(number)) as files:
            for file in files:
                shown = file if file in (path, *path.glob("*.mcap")) else path
                report = ScanReport()
                before = writer.messages
                writer.add(file, report)
                if writer.messages == before:
                    raise InputError(f"{shown}: no message can be used. Leave it out.")
                parts.append(shown)
                lost += [f"{shown.name}: {problem}" for problem in report.problems]
    writer.finish()
    return JoinedLog(tuple(parts), writer.messages, len(writer.channels), tuple(lost))


def _no_part(path: Path, found: str) -> InputError:
    return InputError(
        f"{path}: this is not an MCAP file, a ROS 2 bag directory or a ROS 1 bag{found}. Of a ROS 2 bag, give the "
        "directory."
    )


@contextmanager
def _as_mcap(path: Path, scratch: Path) -> Iterator[list[Path]]:
    """The MCAP files of a part: itself, those of its bag, or what it was converted to (removed at the end)."""
    try:
        path.stat()
    except OSError as error:
        raise _no_part(path, f": {error.strerror}") from error
    parts = bag_parts(path) if path.is_dir() else [path]
    if all(is_mcap(part) for part in parts):
        yield parts
        return
    ros1 = path.suffix == ".bag"
    if not path.is_dir() and not (ros1 and path.is_file()):
        raise _no_part(path, "")
    try:
        convert(
            [path],
            scratch,
            dst_storage="mcap",
            dst_version=_BAG_VERSION,
            compress=None,
            compress_mode="file",
            default_typestore=None if ros1 else get_typestore(Stores.ROS2_HUMBLE),
            typestore=get_typestore(Stores.ROS2_HUMBLE) if ros1 else None,
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
    made = sorted(scratch.glob("*.mcap"))
    yield made
    for file in made:
        file.unlink()


class _Joiner:
    """Writes messages of several logs to one; channels of the same topic and schema become one."""

    def __init__(self, stream: BinaryIO) -> None:
        self._writer = Writer(stream, compression=CompressionType.LZ4)
        self._writer.start(library="wayside")
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self.channels: dict[tuple[str, str, int], int] = {}
        self.messages = 0

    def add(self, part: Path, report: ScanReport) -> None:
        """Append all of a log, in the order of its file."""
        known: dict[int, tuple[Channel, int]] = {}
        for record in scan(part, report):
            if isinstance(record, Metadata):
                self._writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Attachment):
                self._writer.add_attachment(0, 0, record.name, record.media_type, record.data)
            else:
                channel = record.channel
                if channel.id not in known or known[channel.id][0] is not channel:
                    known[channel.id] = channel, self._channel(channel)
                self._writer.add_message(
                    known[channel.id][1],
                    record.log_time_ns,
                    bytes(record.data),
                    record.log_time_ns,
                    record.sequence,
                )
                self.messages += 1

    def finish(self) -> None:
        """Write the summary."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _channel(self, channel: Channel) -> int:
        number = 0
        if channel.schema is not None:
            schema = channel.schema
            kind = schema.name, schema.encoding, schema.data
            if kind not in self._schemas:
                self._schemas[kind] = self._writer.register_schema(*kind)
            number = self._schemas[kind]
        key = channel.topic, channel.encoding, number
        if key not in self.channels:
            self.channels[key] = self._writer.register_channel(*key)
        return self.channels[key]
