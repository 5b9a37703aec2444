"""Foxglove schemas as protobuf."""

from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message as ProtobufMessage
from mcap_protobuf.schema import build_file_descriptor_set

from recordings.drives.arrays import Bytes
from recordings.drives.messages.content import (
    ANTENNA,
    CAMERA,
    DIAGONAL_KNOWN,
    IDENTITY,
    WORLD,
    Calibration,
    CameraPose,
    EncodedMessage,
    FixReading,
)

_TYPES: dict[str, type[ProtobufMessage]] = {
    "foxglove.CompressedImage": CompressedImage,
    "foxglove.RawImage": RawImage,
    "foxglove.CameraCalibration": CameraCalibration,
    "foxglove.PoseInFrame": PoseInFrame,
    "foxglove.LocationFix": LocationFix,
}


class ProtobufMessages:
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

    def compressed(self, time_ns: int, jpeg: bytes) -> EncodedMessage:
        """A JPEG image."""
        fields = {"data": jpeg, "format": "jpeg"}
        return self._message("foxglove.CompressedImage", time_ns, CAMERA, fields)

    def raw(self, time_ns: int, image: Bytes) -> EncodedMessage:
        """A bgr8 image (height, width, 3)."""
        height, width = image.shape[:2]
        fields = {
            "width": width,
            "height": height,
            "encoding": "bgr8",
            "step": width * 3,
            "data": image.tobytes(),
        }
        return self._message("foxglove.RawImage", time_ns, CAMERA, fields)

    def calibration(self, time_ns: int, calibration: Calibration) -> EncodedMessage:
        """Camera calibration."""
        fields = {
            "width": calibration.camera.width,
            "height": calibration.camera.height,
            "distortion_model": "plumb_bob",
            "D": calibration.camera.distortion,
            "K": calibration.k,
            "R": IDENTITY,
            "P": calibration.p,
        }
        return self._message("foxglove.CameraCalibration", time_ns, CAMERA, fields)

    def pose(self, time_ns: int, pose: CameraPose) -> EncodedMessage:
        """Camera pose in the world."""
        position = dict(zip("xyz", map(float, pose.position), strict=True))
        orientation = dict(zip("xyzw", map(float, pose.quaternion), strict=True))
        fields = {"pose": {"position": position, "orientation": orientation}}
        return self._message("foxglove.PoseInFrame", time_ns, WORLD, fields)

    def fix(self, time_ns: int, fix: FixReading) -> EncodedMessage:
        """Position fix."""
        fields = {
            "latitude": fix.latitude,
            "longitude": fix.longitude,
            "altitude": fix.altitude,
            "position_covariance": fix.covariance(),
            "position_covariance_type": DIAGONAL_KNOWN,
        }
        return self._message("foxglove.LocationFix", time_ns, ANTENNA, fields)
