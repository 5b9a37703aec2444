"""Faults of clocks, order, positions and images, written into a log of Foxglove messages by the stock MCAP writer."""

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
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
SECOND, HOUR, YEAR = 10**9, 3600 * 10**9, 365 * 86400 * 10**9
NAN = float("nan")


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
        reader = NonSeekingReader(stream)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            number = counts.get(channel.topic, 0)
            counts[channel.topic] = number + 1
            messages.append(Logged(schema, channel, message.log_time, message.data, number))
    return messages


def write_log(path: Path, messages: Iterable[Logged]) -> None:
    """Write messages in the given order, a chunk a megabyte."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, chunk_size=1 << 20)
        writer.start()
        channels: dict[str, int] = {}
        for one in messages:
            if one.topic not in channels:
                kind, encoding = one.schema, one.channel.message_encoding
                schema = writer.register_schema(kind.name, kind.encoding, kind.data)
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


def moved(
    ns: int,
    messages: Messages,
    *,
    since: int = 0,
    until: int = 10**9,
    topics: Sequence[str] = tuple(TYPES),
    header: bool = True,
    log: bool = True,
) -> Messages:
    """Move times of the messages numbered from `since` to before `until` of some topics."""
    return [
        edited(m, header_ns=ns * header, log_ns=ns * log)
        if m.topic in topics and since <= m.number < until
        else m
        for m in messages
    ]


def dropped(topic: str, numbers: Sequence[int], messages: Messages) -> Messages:
    """Leave out some messages of a topic."""
    return [m for m in messages if m.topic != topic or m.number not in numbers]


def changed(
    topic: str,
    change: Callable[[Any], None],
    messages: Messages,
    *,
    since: int = 0,
    until: int = 10**9,
) -> Messages:
    """Change the content of the messages numbered from `since` to before `until` of a topic."""
    return [
        edited(m, change) if m.topic == topic and since <= m.number < until else m for m in messages
    ]


def swapped_chunks(messages: Messages) -> Messages:
    """Exchange the third and the sixth eighth of the log."""
    n = len(messages) // 8
    parts = [messages[i * n : (i + 1) * n] for i in range(7)] + [messages[7 * n :]]
    parts[2], parts[5] = parts[5], parts[2]
    return [m for part in parts for m in part]


def late(messages: Messages) -> Messages:
    """Write each message up to a second late, drawn by chance from a fixed seed."""
    draw = random.Random(7)
    return sorted(messages, key=lambda m: m.log_ns + draw.randrange(SECOND))


def swapped_messages(messages: Messages) -> Messages:
    """Exchange the places of two image messages in the file; their times stay theirs."""
    a, b = (i for i, m in enumerate(messages) if m.topic == IMAGE and m.number in (10, 14))
    messages = list(messages)
    messages[a], messages[b] = messages[b], messages[a]
    return messages


def image_bytes(messages: Messages) -> dict[int, bytes]:
    """The bytes of each image by its number."""
    images = (m for m in messages if m.topic == IMAGE)
    return {m.number: CompressedImage.FromString(m.data).data for m in images}


def with_bytes(other: Mapping[int, bytes], messages: Messages) -> Messages:
    """Give images by their number other bytes; times and places in the file stay."""
    return [
        edited(m, put("data", other[m.number])) if m.topic == IMAGE and m.number in other else m
        for m in messages
    ]


def swapped_pixels(messages: Messages) -> Messages:
    """Exchange the pixels of two images."""
    data = image_bytes(messages)
    return with_bytes({10: data[11], 11: data[10]}, messages)


def setattr_of(name: str, value: Any, content: Any) -> None:
    """Set a field of a message, or x, y, z of a pose."""
    setattr(content.pose.position if hasattr(content, "pose") else content, name, value)


def put(name: str, value: float | bytes) -> Callable[[Any], None]:
    """A change that sets a field."""
    return partial(setattr_of, name, value)


def scaled(
    messages: Messages, factor: float, topics: Sequence[str] = (IMAGE, CALIBRATION)
) -> Messages:
    """Images and calibration at another size, so that runs cost less."""

    def smaller(content: Any) -> None:
        pixels = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR)
        small = cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        content.data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()

    def smaller_camera(content: Any) -> None:
        content.width = round(content.width * factor)
        content.height = round(content.height * factor)
        for matrix in (content.K, content.P):
            width = len(matrix) // 3
            for k in range(2 * width):
                middle = 0.5 if k % width == 2 else 0.0  # the middle of the first pixel is at 0
                matrix[k] = (matrix[k] + middle) * factor - middle

    changes = {IMAGE: smaller, CALIBRATION: smaller_camera}
    return [edited(m, changes[m.topic]) if m.topic in topics else m for m in messages]


def halved(topics: Sequence[str], messages: Messages) -> Messages:
    """Calibrations or images at half the size from the twelfth on."""
    return [scaled([m], 0.5, topics)[0] if m.number >= 12 else m for m in messages]


def shift(metres: float) -> Callable[[Any], None]:
    """A change that moves a pose."""
    return lambda content: setattr_of("x", content.pose.position.x + metres, content)


def north(degrees: float) -> Callable[[Any], None]:
    """A change that moves a fix."""
    return lambda content: setattr_of("latitude", content.latitude + degrees, content)


def covariance(variance: float) -> Callable[[Any], None]:
    """A change that states the covariance of a fix."""

    def change(content: Any) -> None:
        content.position_covariance[:] = [variance, 0, 0, 0, variance, 0, 0, 0, variance]
        content.position_covariance_type = 2

    return change


def unusable(content: Any) -> None:
    """Make a calibration unusable."""
    content.K[0] = NAN


def longer_quaternion(content: Any) -> None:
    """Make the quaternion of a pose seven times as long."""
    turn = content.pose.orientation
    turn.x, turn.y, turn.z, turn.w = (7.0 * part for part in (turn.x, turn.y, turn.z, turn.w))


def damaged_images(messages: Messages) -> Messages:
    """A tenth of the images cut off, overwritten or emptied, drawn from a fixed seed."""
    draw, damaged = random.Random(0), {}
    data = image_bytes(messages)
    for number in draw.sample(list(data), max(len(data) // 10, 1)):
        whole = data[number]
        at = draw.randrange(len(whole) // 4, 3 * len(whole) // 4)
        cut, rest = whole[:at], whole[at + 2000 :]
        damaged[number] = draw.choice((cut, cut + draw.randbytes(2000) + rest, b""))
    return with_bytes(damaged, messages)


def with_other_camera(messages: Messages) -> Messages:
    """Between images, mirrored ones under another `frame_id` in the same topic."""
    half_ns = 160_000_000

    def mirrored(content: Any) -> None:
        pixels = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR)
        content.frame_id = "rear"
        content.data = cv2.imencode(".jpg", pixels[:, ::-1])[1].tobytes()

    rear = [
        edited(m, mirrored, header_ns=half_ns, log_ns=half_ns) for m in messages if m.topic == IMAGE
    ]
    return sorted([*messages, *rear], key=lambda m: m.log_ns)


SPACING = ("--spacing", "8.0467m")
WAYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "": ((), ()),
    "fixes only": ((POSE,), ()),
    "no fixes": ((GPS,), ()),
    "--spacing": ((GPS,), SPACING),
    "--spacing only": ((POSE, GPS), SPACING),
}
"""What else is recorded and given: topics that are left out, and options of the run."""
ALL, FIXES, NO_FIXES, SPACED, SPACED_ONLY = WAYS
BACK, ONE = partial(moved, -HOUR, since=12), {"since": 10, "until": 11}
HEADER_ONLY = {**ONE, "log": False}
FAULTS: dict[str, tuple[Edit, tuple[str, ...]]] = {
    "as recorded": (list, (ALL, FIXES, SPACED_ONLY)),
    # Clocks
    "all clocks back an hour from image 12": (BACK, (ALL, FIXES, SPACED_ONLY)),
    "all clocks back 3 s from image 12": (partial(moved, -3 * SECOND, since=12), (ALL,)),
    "all clocks ahead an hour from image 12": (partial(moved, HOUR, since=12), (ALL,)),
    "log clock back an hour, headers sound": (partial(BACK, header=False), (ALL,)),
    "headers back an hour, log clock sound": (partial(BACK, log=False), (ALL,)),
    "camera clock back an hour": (partial(BACK, topics=(IMAGE,), log=False), (ALL,)),
    "first image a year ahead": (partial(moved, YEAR, until=1, topics=(IMAGE,)), (ALL,)),
    "first messages a year ahead": (partial(moved, YEAR, until=1), (ALL,)),
    "an image header a year ahead": (partial(moved, YEAR, topics=(IMAGE,), **HEADER_ONLY), (ALL,)),
    "an image header a year back": (partial(moved, -YEAR, topics=(IMAGE,), **HEADER_ONLY), (ALL,)),
    "a pose header a year ahead": (partial(moved, YEAR, topics=(POSE,), **HEADER_ONLY), (ALL,)),
    "a fix header a year ahead": (partial(moved, YEAR, topics=(GPS,), **HEADER_ONLY), (FIXES,)),
    "pose headers a year ahead": (partial(moved, YEAR, topics=(POSE,), log=False), (ALL,)),
    # Order
    "two chunks swapped": (swapped_chunks, (ALL,)),
    "messages reversed": (lambda m: m[::-1], (ALL, FIXES, SPACED_ONLY)),
    "messages up to 1 s late": (late, (ALL, FIXES)),
    "two image messages swapped": (swapped_messages, (ALL,)),
    "pixels of two images swapped": (swapped_pixels, (ALL, SPACED_ONLY)),
    # Gaps
    "one pose missing": (partial(dropped, POSE, (10,)), (ALL, NO_FIXES)),
    "poses from image 8 on": (partial(dropped, POSE, range(8)), (NO_FIXES, SPACED)),
    "poses until image 16": (partial(dropped, POSE, range(16, 24)), (NO_FIXES, SPACED)),
    # Outliers
    "one pose off by 5 km": (partial(changed, POSE, shift(5000.0), **ONE), (ALL,)),
    "one pose off by 20 m": (partial(changed, POSE, shift(20.0), **ONE), (ALL,)),
    "three poses off by 5 km": (partial(changed, POSE, shift(5e3), since=10, until=13), (ALL,)),
    "first pose off by 5 km": (partial(changed, POSE, shift(5000.0), until=1), (ALL,)),
    "poses jump by 5 km and stay": (partial(changed, POSE, shift(5000.0), since=12), (ALL,)),
    "one pose at 1e308": (partial(changed, POSE, put("x", 1e308), **ONE), (ALL,)),
    "all poses NaN": (partial(changed, POSE, put("x", NAN)), (ALL, NO_FIXES)),
    "one fix off by 5 km": (partial(changed, GPS, north(0.045), **ONE), (ALL, FIXES)),
    "first fix off by 5 km": (partial(changed, GPS, north(0.045), until=1), (FIXES,)),
    "all fixes NaN": (partial(changed, GPS, put("latitude", NAN)), (ALL,)),
    "half of the fixes NaN": (partial(changed, GPS, put("latitude", NAN), since=12), (FIXES,)),
    "one altitude 1e15": (partial(changed, GPS, put("altitude", 1e15), **ONE), (ALL,)),
    "all altitudes 1e15": (partial(changed, GPS, put("altitude", 1e15)), (ALL,)),
    "covariance 1e16 of one fix": (partial(changed, GPS, covariance(1e16), **ONE), (ALL,)),
    "covariance 1e16 of all fixes": (partial(changed, GPS, covariance(1e16)), (ALL, FIXES)),
    "covariance 9e5 of all fixes": (partial(changed, GPS, covariance(9e5)), (FIXES,)),
    "calibrations NaN from the third": (partial(changed, CALIBRATION, unusable, since=2), (ALL,)),
    # Content
    "one quaternion of length 7": (partial(changed, POSE, longer_quaternion, **ONE), (ALL,)),
    "covariance -1 of all fixes": (partial(changed, GPS, covariance(-1.0)), (FIXES,)),
    "covariance NaN of one fix": (partial(changed, GPS, covariance(NAN), **ONE), (ALL,)),
    "calibration half as large from image 12": (partial(halved, (CALIBRATION,)), (ALL,)),
    "all half as large from image 12": (partial(halved, (CALIBRATION, IMAGE)), (ALL,)),
    "one image without a byte": (partial(changed, IMAGE, put("data", b""), **ONE), (ALL,)),
    "a tenth of the images damaged": (damaged_images, (ALL, SPACED_ONLY)),
    "images of another camera between": (with_other_camera, (ALL,)),
    "all sequence numbers alike": (lambda m: [replace(x, number=7) for x in m], (ALL,)),
}


def _given(edit: Edit, left_out: tuple[str, ...]) -> Edit:
    return lambda messages: edit([m for m in messages if m.topic not in left_out])


ATTACKS: dict[str, tuple[Edit, tuple[str, ...]]] = {
    f"{name}, {way}" if way else name: (_given(edit, WAYS[way][0]), WAYS[way][1])
    for name, (edit, ways) in FAULTS.items()
    for way in ways
}
"""Every fault in each of its ways: how it is written into the messages of a log, and options of the run."""
