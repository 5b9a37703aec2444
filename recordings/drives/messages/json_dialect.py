"""Foxglove schemas as JSON."""

import base64
import json
from typing import Any

from recordings.drives.messages.content import EncodedMessage
from recordings.drives.messages.foxglove import FoxgloveMessages

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


class JsonMessages(FoxgloveMessages):
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
        body = {"timestamp": stamp, "frame_id": frame, **fields}
        return name, json.dumps(body, default=lambda data: base64.b64encode(data).decode()).encode()
