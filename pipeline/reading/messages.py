"""Which message types are understood, found by the name of their schema and never by their topic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any

from wayside.pipeline.reading import fields
from wayside.pipeline.reading.contents import Content, ContentError
from wayside.pipeline.reading.encodings import Unpack, unpacker_for
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
    "foxglove.CompressedImage": (Kind.IMAGE, fields.compressed_image),
    "foxglove.CompressedVideo": (Kind.IMAGE, fields.compressed_video),
    "foxglove.RawImage": (Kind.IMAGE, fields.raw_image),
    "foxglove.CameraCalibration": (Kind.CALIBRATION, fields.calibration),
    "foxglove.PoseInFrame": (Kind.POSE, fields.pose),
    "foxglove.PosesInFrame": (Kind.POSE, fields.poses),
    "foxglove.FrameTransform": (Kind.TRANSFORM, fields.transform),
    "foxglove.FrameTransforms": (Kind.TRANSFORM, fields.transforms),
    "foxglove.LocationFix": (Kind.FIX, fields.fix),
    "sensor_msgs/msg/CompressedImage": (Kind.IMAGE, fields.compressed_image),
    "sensor_msgs/msg/Image": (Kind.IMAGE, fields.raw_image),
    "sensor_msgs/msg/CameraInfo": (Kind.CALIBRATION, fields.calibration),
    "geometry_msgs/msg/PoseStamped": (Kind.POSE, fields.pose),
    "geometry_msgs/msg/TransformStamped": (Kind.TRANSFORM, fields.transform),
    "tf2_msgs/msg/TFMessage": (Kind.TRANSFORM, fields.transforms),
    "nav_msgs/msg/Odometry": (Kind.ODOMETRY, fields.odometry),
    "sensor_msgs/msg/NavSatFix": (Kind.FIX, fields.fix),
    "foxglove_msgs/msg/CompressedVideo": (Kind.IMAGE, fields.compressed_video),
}

ROS_TYPES = tuple(name for name in _TYPES if "/" in name)
"""Types of ROS that are understood."""


def type_name(channel: Channel) -> str:
    """Name of a channel's schema, ROS types in the form `package/msg/Type`."""
    parts = channel.schema_name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else channel.schema_name


def kind_of(channel: Channel) -> Kind | None:
    """What a channel is for; None where its type is of no use here."""
    known = _TYPES.get(type_name(channel))
    return None if known is None else known[0]


class Decoders:
    """Decodes messages of any channel. Keeps one unpacker for each channel, or the reason why it has no unpacker."""

    def __init__(self) -> None:
        self._by_channel: dict[int, tuple[Channel, Unpack | str]] = {}

    def decode(self, channel: Channel, content: memoryview) -> Sequence[Content]:
        """What a message says: one content, or none, or several (transforms).

        Raises ContentError where the bytes do not follow the schema, or what they say makes no sense.
        """
        name = type_name(channel)
        known = self._by_channel.get(channel.id)
        if known is None or known[0] is not channel:
            try:
                known = channel, unpacker_for(channel, name)
            except ContentError as error:
                known = channel, str(error)
            self._by_channel[channel.id] = known
        unpack = known[1]
        if isinstance(unpack, str):
            raise ContentError(unpack)
        try:
            return _TYPES[name][1](*unpack(content))
        except ContentError:
            raise
        except Exception as error:  # each decoding library has errors of its own for damaged bytes
            raise ContentError(f"it does not follow its schema ({error})") from error
