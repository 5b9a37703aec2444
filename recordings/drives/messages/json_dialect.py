"""Foxglove schemas as JSON."""

import base64
import json
from typing import Any

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

_NUMBER, _STRING = {"type": "number"}, {"type": "string"}
_COUNT = {"type": "integer", "minimum": 0}
_BYTES = {"type": "string", "contentEncoding": "base64"}
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999999999},
    },
}


def _array(count: int | None = None) -> dict[str, Any]:
    bounds = {"minItems": count, "maxItems": count} if count else {}
    return {"type": "array", "items": _NUMBER, **bounds}


def _object(title: str, properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _stamped(title: str, properties: dict[str, Any]) -> dict[str, Any]:
    return _object(title, {"timestamp": _TIME, "frame_id": _STRING, **properties})


_XYZ = {"x": _NUMBER, "y": _NUMBER, "z": _NUMBER}
_POSE = _object(
    "foxglove.Pose",
    {
        "position": _object("foxglove.Vector3", _XYZ),
        "orientation": _object("foxglove.Quaternion", {**_XYZ, "w": _NUMBER}),
    },
)
_PROPERTIES: dict[str, dict[str, Any]] = {
    "foxglove.CompressedImage": {"data": _BYTES, "format": _STRING},
    "foxglove.RawImage": {
        "width": _COUNT,
        "height": _COUNT,
        "encoding": _STRING,
        "step": _COUNT,
        "data": _BYTES,
    },
    "foxglove.CameraCalibration": {
        "width": _COUNT,
        "height": _COUNT,
        "distortion_model": _STRING,
        "D": _array(),
        "K": _array(9),
        "R": _array(9),
        "P": _array(12),
    },
    "foxglove.PoseInFrame": {"pose": _POSE},
    "foxglove.LocationFix": {
        "latitude": _NUMBER,
        "longitude": _NUMBER,
        "altitude": _NUMBER,
        "position_covariance": _array(9),
        "position_covariance_type": _COUNT,
    },
}


class JsonMessages:
    """Messages as JSON objects, bytes in base64."""

    encoding = "json"
    schema_encoding = "jsonschema"

    def schema(self, name: str) -> bytes:
        """JSON schema of a message type."""
        return json.dumps(_stamped(name, _PROPERTIES[name])).encode()

    def _message(
        self, name: str, time_ns: int, frame: str, fields: dict[str, Any]
    ) -> EncodedMessage:
        stamp = {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}
        return name, json.dumps({"timestamp": stamp, "frame_id": frame, **fields}).encode()

    def compressed(self, time_ns: int, jpeg: bytes) -> EncodedMessage:
        """A JPEG image."""
        fields = {"data": base64.b64encode(jpeg).decode(), "format": "jpeg"}
        return self._message("foxglove.CompressedImage", time_ns, CAMERA, fields)

    def raw(self, time_ns: int, image: Bytes) -> EncodedMessage:
        """A bgr8 image (height, width, 3)."""
        height, width = image.shape[:2]
        fields = {
            "width": width,
            "height": height,
            "encoding": "bgr8",
            "step": width * 3,
            "data": base64.b64encode(image.tobytes()).decode(),
        }
        return self._message("foxglove.RawImage", time_ns, CAMERA, fields)

    def calibration(self, time_ns: int, calibration: Calibration) -> EncodedMessage:
        """Camera calibration."""
        fields = {
            "width": calibration.camera.width,
            "height": calibration.camera.height,
            "distortion_model": "plumb_bob",
            "D": list(calibration.camera.distortion),
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
