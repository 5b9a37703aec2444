"""Foxglove schemas as protobuf."""

from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message as ProtobufMessage
from mcap_protobuf.schema import build_file_descriptor_set

from recordings.drives.messages.content import EncodedMessage
from recordings.drives.messages.foxglove import FoxgloveMessages

_TYPES: dict[str, type[ProtobufMessage]] = {
    "foxglove.CompressedImage": CompressedImage,
    "foxglove.RawImage": RawImage,
    "foxglove.CameraCalibration": CameraCalibration,
    "foxglove.PoseInFrame": PoseInFrame,
    "foxglove.LocationFix": LocationFix,
}


class ProtobufMessages(FoxgloveMessages):
    """Messages serialised with fields in the order of their numbers."""

    encoding = "protobuf"
    schema_encoding = "protobuf"

    def schema(self, name: str) -> bytes:
        """Serialised file descriptor set of a message type."""
        descriptors = build_file_descriptor_set(_TYPES[name])
        return bytes(descriptors.SerializeToString(deterministic=True))

    def _message(
        self, name: str, time_ns: int, frame: str, fields: dict[str, Any]
    ) -> EncodedMessage:
        message: Any = _TYPES[name](frame_id=frame, **fields)
        message.timestamp.FromNanoseconds(time_ns)
        return name, message.SerializeToString(deterministic=True)
