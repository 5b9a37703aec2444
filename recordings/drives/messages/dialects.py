"""The dialects by name, and the topics each of them uses."""

from collections.abc import Callable
from dataclasses import dataclass

from recordings.drives import spec
from recordings.drives.messages.content import Dialect
from recordings.drives.messages.json_dialect import JsonMessages
from recordings.drives.messages.protobuf_dialect import ProtobufMessages
from recordings.drives.messages.ros2_dialect import Ros2Messages

DIALECTS: dict[spec.DialectName, Callable[[], Dialect]] = {
    "protobuf": ProtobufMessages,
    "ros2": Ros2Messages,
    "json": JsonMessages,
}


@dataclass(frozen=True, slots=True)
class Topics:
    """Names of the topics of a drive."""

    image: str
    calibration: str
    pose: str
    fix: str


def topics(dialect: spec.DialectName, raw: bool) -> Topics:
    """Topics as users of a dialect name them."""
    if dialect == "ros2":
        image = "/front/image_raw" if raw else "/front/image_raw/compressed"
        return Topics(image, "/front/camera_info", "/odom", "/fix")
    return Topics("/camera/image", "/camera/calibration", "/pose", "/gps")
