"""Messages of Foxglove and of ROS: from bytes (protobuf, ROS 2 CDR, JSON) to what they say.

Types are found by the name of their schema and never by their topic. Both name most of their fields alike:
https://docs.foxglove.dev/docs/sdk/schemas, https://docs.ros.org/en/humble/p/sensor_msgs
"""

import base64
import json
import math
from collections.abc import Callable, Sequence
from enum import Enum
from functools import cache
from types import SimpleNamespace
from typing import Any

from mcap.records import Schema as McapSchema
from mcap_protobuf.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from wayside.pipeline.reading.calibrations import Region, make_calibration
from wayside.pipeline.reading.contents import (
    VAGUEST_M,
    CalibrationContent,
    Content,
    ContentError,
    FixContent,
    ImageContent,
    PoseContent,
    make_fix,
    stamp_ns,
)
from wayside.pipeline.reading.h264 import H264
from wayside.pipeline.reading.layout import Channel

_Unpack = Callable[[memoryview], Any]
_VIDEO_FIELDS = "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
"""Of the one type that is understood and not of ROS itself; https://github.com/foxglove/schemas"""

_STANDARD_ALPHABET = str.maketrans("-_", "+/")

_NO_FIX = -1


class Kind(Enum):
    """What the messages of a channel are for."""

    IMAGE = "images"
    CALIBRATION = "calibration"
    POSE = "poses"
    TRANSFORM = "transforms"
    ODOMETRY = "odometry"
    FIX = "fixes"


@cache
def _typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_VIDEO_FIELDS, "foxglove_msgs/msg/CompressedVideo"))
    return store


def _unpacker(channel: Channel, type_name: str) -> _Unpack:
    """A function that makes an object with the fields of a message from its bytes.

    Raises ContentError where the encoding is unknown or does not go with the schema.
    """
    if channel.encoding == "json":
        return lambda content: json.loads(
            bytes(content), object_hook=lambda fields: SimpleNamespace(**fields)
        )
    if channel.encoding == "cdr":
        store = _typestore()
        if type_name not in store.fielddefs:
            raise ContentError(f"type {type_name} is not supported in CDR")
        return lambda content: store.deserialize_cdr(content, type_name)
    if channel.encoding != "protobuf":
        raise ContentError(
            f"encoding {channel.encoding!r} is not supported; protobuf, cdr and json are"
        )
    schema = channel.schema
    if schema is None:
        raise ContentError("it has no schema")
    stock = McapSchema(schema.id, schema.data, schema.encoding, schema.name)
    try:
        decode = DecoderFactory().decoder_for("protobuf", stock)
    except Exception as error:  # the protobuf runtime has many errors for a damaged descriptor
        raise ContentError(f"its protobuf schema is damaged ({error})") from error
    if decode is None:
        raise ContentError(f"its schema is in {schema.encoding!r}, not protobuf")
    return lambda content: decode(bytes(content))


def _data(message: Any) -> memoryview:
    """Bytes of the field `data`, none where there is no such field.

    In JSON it is base64, with line breaks or without, in either alphabet, or a list of bytes.
    """
    data = getattr(message, "data", b"")
    if isinstance(data, str):
        text = "".join(data.split()).translate(_STANDARD_ALPHABET)
        data = base64.b64decode(text + "=" * (-len(text) % 4), validate=True)
    return memoryview(bytes(data) if isinstance(data, list) else data)


def compressed_image(message: Any, data: memoryview) -> list[ImageContent]:
    """A compressed image. Its format is free text such as "bgr8, jpeg compressed bgr8"."""
    return [ImageContent(*_head(message), _text(message.format), data)]


def compressed_video(message: Any, data: memoryview) -> list[ImageContent]:
    """One picture of an H.264 stream; raises ContentError where the video is of another format."""
    if message.format.lower() != H264:
        raise ContentError(f"it is video of the format {message.format!r}; h264 is supported")
    return [ImageContent(*_head(message), H264, data)]


def raw_image(message: Any, data: memoryview) -> list[ImageContent]:
    """Rows of pixels."""
    m = message
    encoding = _text(m.encoding)
    if getattr(m, "is_bigendian", 0) and "16" in encoding:
        encoding += " (big-endian)"
    return [ImageContent(*_head(m), encoding, data, m.width, m.height, m.step)]


def calibration(message: Any, _: memoryview) -> list[CalibrationContent]:
    """A calibration; ROS names its matrices in small letters, ROS 1 and Foxglove in capitals."""
    m = message
    k, d, p = (
        tuple(map(float, getattr(m, name, getattr(m, name.upper(), ()))))
        for name in ("k", "d", "p")
    )
    binning = (int(getattr(m, f"binning_{axis}", 0)) or 1 for axis in "xy")
    roi = getattr(m, "roi", None)
    part = (getattr(roi, name, 0) for name in ("x_offset", "y_offset", "width", "height"))
    region = Region(*map(int, part), *binning)
    if min(region) < 0:
        raise ContentError("its region of interest or binning is negative")
    lens = _text(getattr(m, "distortion_model", "")), d
    return [make_calibration(*_head(m), (int(m.width), int(m.height)), k, p, lens, region)]


def pose(message: Any, _: memoryview) -> list[PoseContent]:
    """A pose; of several the first, which is the one at the time stamp."""
    own = message.poses[:1] if hasattr(message, "poses") else [message.pose]
    return [_pose(message, one) for one in own]


def transforms(message: Any, _: memoryview) -> list[PoseContent]:
    """One transform, or several."""
    found = []
    for one in getattr(message, "transforms", [message]):
        time_ns, parent = _head(one)
        inner = getattr(one, "transform", one)
        r, t = inner.rotation, inner.translation
        turn, shift = (r.x, r.y, r.z, r.w), (t.x, t.y, t.z)
        parent = _text(getattr(one, "parent_frame_id", parent))
        found.append(PoseContent(time_ns, parent, _text(one.child_frame_id), turn, shift))
    return found


def odometry(message: Any, _: memoryview) -> list[PoseContent]:
    """`nav_msgs/msg/Odometry`, with the sigmas of its pose covariance (x, y, z, then rotations about them)."""
    sigma_m, sigma_rad = None, None
    if len(message.pose.covariance) == 36:
        variances = [float(variance) for variance in message.pose.covariance[::7]]
        sigma_m, sigma_rad = _sigma(variances[:3]), _sigma(variances[3:])
    return [_pose(message, message.pose.pose, _text(message.child_frame_id), sigma_m, sigma_rad)]


def fix(message: Any, _: memoryview) -> list[FixContent]:
    """`foxglove.LocationFix`, `sensor_msgs/msg/NavSatFix`; nothing while the receiver has no fix."""
    m = message
    status = getattr(m, "status", None)
    if status is not None and status.status == _NO_FIX:
        return []
    known = getattr(m, "position_covariance_type", 0)
    covariance = tuple(map(float, m.position_covariance)) if known else None
    return make_fix(_head(m)[0], m.latitude, m.longitude, m.altitude, covariance)


def _sigma(variances: list[float]) -> float | None:
    """Root of the mean variance; None where it is unknown (zero, negative, not a number, `VAGUEST_M` and more)."""
    if not all(variance > 0 for variance in variances) or not sum(variances) / 3 < VAGUEST_M**2:
        return None
    return math.sqrt(sum(variances) / 3)


def _pose(message: Any, pose: Any, child: str = "", *more: Any) -> PoseContent:
    p, q = pose.position, pose.orientation
    return PoseContent(*_head(message), child, (q.x, q.y, q.z, q.w), (p.x, p.y, p.z), *more)


def _head(message: Any) -> tuple[int | None, str]:
    """Time stamp in ns, None where it is not set, and `frame_id`: of a header of ROS, or as Foxglove has them."""
    header = getattr(message, "header", message)
    stamp = getattr(header, "stamp", getattr(header, "timestamp", None))
    time_ns = None
    if stamp is not None:
        seconds = stamp.seconds if hasattr(stamp, "seconds") else stamp.sec
        rest = [getattr(stamp, name, 0) for name in ("nanos", "nanosec", "nsec")]
        time_ns = stamp_ns(seconds, max(rest))
    return time_ns, _text(getattr(header, "frame_id", ""))


def _text(value: str) -> str:
    """The text; raises where JSON holds another type, or half a character."""
    value.encode()
    return value


_Read = Callable[[Any, memoryview], Sequence[Content]]

_TYPES: dict[str, tuple[Kind, _Read]] = {
    "foxglove.CompressedImage": (Kind.IMAGE, compressed_image),
    "foxglove.CompressedVideo": (Kind.IMAGE, compressed_video),
    "foxglove.RawImage": (Kind.IMAGE, raw_image),
    "foxglove.CameraCalibration": (Kind.CALIBRATION, calibration),
    "foxglove.PoseInFrame": (Kind.POSE, pose),
    "foxglove.PosesInFrame": (Kind.POSE, pose),
    "foxglove.FrameTransform": (Kind.TRANSFORM, transforms),
    "foxglove.FrameTransforms": (Kind.TRANSFORM, transforms),
    "foxglove.LocationFix": (Kind.FIX, fix),
    "sensor_msgs/msg/CompressedImage": (Kind.IMAGE, compressed_image),
    "sensor_msgs/msg/Image": (Kind.IMAGE, raw_image),
    "sensor_msgs/msg/CameraInfo": (Kind.CALIBRATION, calibration),
    "geometry_msgs/msg/PoseStamped": (Kind.POSE, pose),
    "geometry_msgs/msg/TransformStamped": (Kind.TRANSFORM, transforms),
    "tf2_msgs/msg/TFMessage": (Kind.TRANSFORM, transforms),
    "nav_msgs/msg/Odometry": (Kind.ODOMETRY, odometry),
    "sensor_msgs/msg/NavSatFix": (Kind.FIX, fix),
    "foxglove_msgs/msg/CompressedVideo": (Kind.IMAGE, compressed_video),
}

ROS_TYPES = tuple(name for name in _TYPES if "/" in name)
"""Types of ROS that are understood."""


def type_name(channel: Channel) -> str:
    """Name of a channel's schema, ROS types in the form `package/msg/Type`."""
    parts = channel.schema_name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else channel.schema_name


def kind_of(channel: Channel) -> Kind | None:
    """What a channel is for; None where its type is of no use here."""
    return _TYPES.get(type_name(channel), (None,))[0]


class Decoders:
    """Decodes messages of any channel. Keeps one unpacker for each channel that has one."""

    def __init__(self) -> None:
        self._by_channel: dict[int, tuple[Channel, _Unpack]] = {}

    def decode(self, channel: Channel, content: memoryview) -> Sequence[Content]:
        """What a message says: one content, or none, or several (transforms).

        Raises ContentError where the bytes do not follow the schema, or what they say makes no sense.
        """
        name = type_name(channel)
        known = self._by_channel.get(channel.id)
        if known is None or known[0] is not channel:
            known = self._by_channel[channel.id] = channel, _unpacker(channel, name)
        try:
            message = known[1](content)
            return _TYPES[name][1](message, _data(message))
        except ContentError:
            raise
        except Exception as error:  # each decoding library has errors of its own for damaged bytes
            raise ContentError(f"it does not follow its schema ({error})") from error
