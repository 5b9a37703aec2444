"""The messages of a log of Foxglove schemas, read, changed and written again by the stock MCAP packages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

IMAGE, POSE, GPS, CALIBRATION = "/camera/image", "/pose", "/gps", "/camera/calibration"
TYPES: dict[str, Callable[[], Any]] = {
    IMAGE: CompressedImage,
    POSE: PoseInFrame,
    GPS: LocationFix,
    CALIBRATION: CameraCalibration,
}


@dataclass(frozen=True)
class Logged:
    """A message with the channel and schema it was recorded on; `number`: its place in its topic, from 0."""

    schema: Schema
    channel: Channel
    log_ns: int
    data: bytes
    number: int

    @property
    def topic(self) -> str:
        """Its topic."""
        return self.channel.topic


Messages = list[Logged]
Edit = Callable[[Messages], Messages]


def read_log(path: Path) -> Messages:
    """All messages in file order."""
    counts: dict[str, int] = {}
    messages = []
    with path.open("rb") as stream:
        for schema, channel, message in NonSeekingReader(stream).iter_messages(
            log_time_order=False
        ):
            assert schema is not None
            number = counts.get(channel.topic, 0)
            counts[channel.topic] = number + 1
            messages.append(Logged(schema, channel, message.log_time, message.data, number))
    return messages


def write_log(path: Path, messages: Messages) -> None:
    """Write messages in the given order, a chunk a megabyte."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, chunk_size=1 << 20)
        writer.start()
        channels: dict[str, int] = {}
        for one in messages:
            if one.topic not in channels:
                schema = writer.register_schema(
                    one.schema.name, one.schema.encoding, one.schema.data
                )
                encoding = one.channel.message_encoding
                channels[one.topic] = writer.register_channel(one.topic, encoding, schema)
            writer.add_message(channels[one.topic], one.log_ns, one.data, one.log_ns, one.number)
        writer.finish()


def edited(
    one: Logged, change: Callable[[Any], None] | None = None, *, header_ns: int = 0, log_ns: int = 0
) -> Logged:
    """A message with its content changed, and its header and log time moved."""
    content = TYPES[one.topic]()
    content.ParseFromString(one.data)
    if header_ns:
        content.timestamp.FromNanoseconds(content.timestamp.ToNanoseconds() + header_ns)
    if change is not None:
        change(content)
    return replace(one, data=content.SerializeToString(), log_ns=one.log_ns + log_ns)
