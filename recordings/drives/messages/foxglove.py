"""Foxglove schemas, whatever they are written in."""

from abc import ABC, abstractmethod
from typing import Any

from recordings.drives.arrays import Bytes
from recordings.drives.messages import content


class FoxgloveMessages(ABC):
    """The fields of each message."""

    @abstractmethod
    def _message(
        self, name: str, time_ns: int, frame: str, fields: dict[str, Any]
    ) -> content.EncodedMessage:
        """A message of a type and frame of reference."""

    def compressed(self, time_ns: int, jpeg: bytes) -> content.EncodedMessage:
        """A JPEG image."""
        fields = {"data": jpeg, "format": "jpeg"}
        return self._message("foxglove.CompressedImage", time_ns, content.CAMERA, fields)

    def raw(self, time_ns: int, image: Bytes) -> content.EncodedMessage:
        """A bgr8 image (height, width, 3)."""
        height, width = image.shape[:2]
        fields = {
            "width": width,
            "height": height,
            "encoding": "bgr8",
            "step": width * 3,
            "data": image.tobytes(),
        }
        return self._message("foxglove.RawImage", time_ns, content.CAMERA, fields)

    def calibration(self, time_ns: int, calibration: content.Calibration) -> content.EncodedMessage:
        """Camera calibration."""
        fields = {
            "width": calibration.camera.width,
            "height": calibration.camera.height,
            "distortion_model": "plumb_bob",
            "D": list(calibration.camera.distortion),
            "K": calibration.k,
            "R": content.IDENTITY,
            "P": calibration.p,
        }
        return self._message("foxglove.CameraCalibration", time_ns, content.CAMERA, fields)

    def pose(self, time_ns: int, pose: content.CameraPose) -> content.EncodedMessage:
        """Camera pose in the world."""
        position = dict(zip("xyz", map(float, pose.position), strict=True))
        orientation = dict(zip("xyzw", map(float, pose.quaternion), strict=True))
        fields = {"pose": {"position": position, "orientation": orientation}}
        return self._message("foxglove.PoseInFrame", time_ns, content.WORLD, fields)

    def fix(self, time_ns: int, fix: content.FixReading) -> content.EncodedMessage:
        """Position fix."""
        fields = {
            "latitude": fix.latitude,
            "longitude": fix.longitude,
            "altitude": fix.altitude,
            "position_covariance": fix.covariance(),
            "position_covariance_type": content.DIAGONAL_KNOWN,
        }
        return self._message("foxglove.LocationFix", time_ns, content.ANTENNA, fields)
