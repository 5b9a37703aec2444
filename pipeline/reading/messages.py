"""Which message types are understood, found by the name of their schema and never by their topic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any

from wayside.pipeline.reading import foxglove, ros2
from wayside.pipeline.reading.contents import Content, ContentError
from wayside.pipeline.reading.encodings import EncodingError, unpacker_for
from wayside.pipeline.reading.layout import Channel


class Kind(Enum):
    """What the messages of a channel are for."""

    IMAGE = "images"
    CALIBRATION = "calibration"
    POSE = "poses"
    TRANSFORM = "transforms"
    ODOMETRY = "odometry"
    FIX = "fixes"


_Read = Callable[[Any, memoryview], Sequence[Content]]

_TYPES: dict[str, tuple[Kind, _Read]] = {
    "foxglove.CompressedImage": (Kind.IMAGE, foxglove.compressed_image),
    "foxglove.CompressedVideo": (Kind.IMAGE, foxglove.compressed_video),
    "foxglove.RawImage": (Kind.IMAGE, foxglove.raw_image),
    "foxglove.CameraCalibration": (Kind.CALIBRATION, foxglove.calibration),
    "foxglove.PoseInFrame": (Kind.POSE, foxglove.pose_in_frame),
    "foxglove.PosesInFrame": (Kind.POSE, foxglove.poses_in_frame),
    "foxglove.FrameTransform": (Kind.TRANSFORM, foxglove.frame_transform),
    "foxglove.FrameTransforms": (Kind.TRANSFORM, foxglove.frame_transforms),
    "foxglove.LocationFix": (Kind.FIX, foxglove.location_fix),
    "sensor_msgs/msg/CompressedImage": (Kind.IMAGE, ros2.compressed_image),
    "sensor_msgs/msg/Image": (Kind.IMAGE, ros2.image),
    "sensor_msgs/msg/CameraInfo": (Kind.CALIBRATION, ros2.camera_info),
    "geometry_msgs/msg/PoseStamped": (Kind.POSE, ros2.pose_stamped),
    "geometry_msgs/msg/TransformStamped": (Kind.TRANSFORM, ros2.transform_stamped),
    "tf2_msgs/msg/TFMessage": (Kind.TRANSFORM, ros2.transforms),
    "nav_msgs/msg/Odometry": (Kind.ODOMETRY, ros2.odometry),
    "sensor_msgs/msg/NavSatFix": (Kind.FIX, ros2.nav_sat_fix),
    "foxglove_msgs/msg/CompressedVideo": (Kind.IMAGE, ros2.compressed_video),
}

ROS_TYPES = tuple(name for name in _TYPES if "/" in name)
"""Types of ROS that are understood."""


class MessageError(ValueError):
    """A message that cannot be decoded."""


def type_name(channel: Channel) -> str:
    """Name of a channel's schema, ROS types in the form `package/msg/Type`."""
    return _full_name(channel.schema_name)


def is_known_type(schema_name: str) -> bool:
    """Whether messages of a schema of this name are understood."""
    return _full_name(schema_name) in _TYPES


def _full_name(schema_name: str) -> str:
    parts = schema_name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else schema_name


def kind_of(channel: Channel) -> Kind | None:
    """What a channel is for; None where its type is of no use here."""
    known = _TYPES.get(type_name(channel))
    return None if known is None else known[0]


class Decoders:
    """Decodes messages of any channel; keeps one decoder a channel."""

    def __init__(self) -> None:
        self._by_channel: dict[int, tuple[Channel, Callable[[memoryview], Sequence[Content]]]] = {}

    def decode(self, channel: Channel, content: memoryview) -> Sequence[Content]:
        """What a message says: one content, or none, or several (transforms).

        Raises
        ------
        MessageError
            The bytes do not follow the schema, or what they say makes no sense.
        """
        known = self._by_channel.get(channel.id)
        if known is None or known[0] is not channel:
            known = channel, _decoder(channel)
            self._by_channel[channel.id] = known
        try:
            return known[1](content)
        except (EncodingError, ContentError) as error:
            raise MessageError(str(error)) from error
        except Exception as error:  # each decoding library has errors of its own for damaged bytes
            raise MessageError(f"it does not follow its schema ({error})") from error


def _decoder(channel: Channel) -> Callable[[memoryview], Sequence[Content]]:
    name = type_name(channel)
    _, read = _TYPES[name]
    try:
        unpack = unpacker_for(channel, name)
    except EncodingError as error:
        reason = str(error)

        def refuse(_: memoryview) -> Sequence[Content]:
            raise EncodingError(reason)

        return refuse

    def decode(content: memoryview) -> Sequence[Content]:
        message, data = unpack(content)
        return read(message, data)

    return decode
