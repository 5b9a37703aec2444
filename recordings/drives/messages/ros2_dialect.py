"""ROS 2 messages as CDR."""

from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from recordings.drives.arrays import Bytes, Floats
from recordings.drives.messages import content
from recordings.drives.messages.ros2_definitions import definition

_UNKNOWN = -1.0
"""First element of a covariance that says nothing."""


class Ros2Messages:
    """Messages as a ROS 2 Humble recorder writes them."""

    encoding = "cdr"
    schema_encoding = "ros2msg"

    def __init__(self) -> None:
        self._types = get_typestore(Stores.ROS2_HUMBLE)

    def schema(self, name: str) -> bytes:
        """Concatenated message definition."""
        return definition(name).encode()

    def _make(self, name: str, **fields: Any) -> Any:
        return self._types.types[name](**fields)

    def _xyz(self, name: str, values: Floats) -> Any:
        x, y, z = map(float, values)
        return self._make(name, x=x, y=y, z=z)

    def _message(
        self, name: str, time_ns: int, frame: str, fields: dict[str, Any]
    ) -> content.EncodedMessage:
        stamp = self._make(
            "builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9
        )
        header = self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)
        message = self._make(name, header=header, **fields)
        return name, bytes(self._types.serialize_cdr(message, name))

    def compressed(self, time_ns: int, jpeg: bytes) -> content.EncodedMessage:
        """A JPEG image."""
        data = np.frombuffer(jpeg, np.uint8)
        fields = {"format": "bgr8; jpeg compressed bgr8", "data": data}
        return self._message("sensor_msgs/msg/CompressedImage", time_ns, content.CAMERA, fields)

    def raw(self, time_ns: int, image: Bytes) -> content.EncodedMessage:
        """A bgr8 image (height, width, 3)."""
        height, width = image.shape[:2]
        fields = {
            "height": height,
            "width": width,
            "encoding": "bgr8",
            "is_bigendian": 0,
            "step": width * 3,
            "data": image.ravel(),
        }
        return self._message("sensor_msgs/msg/Image", time_ns, content.CAMERA, fields)

    def calibration(self, time_ns: int, calibration: content.Calibration) -> content.EncodedMessage:
        """Camera calibration."""
        whole = self._make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        )
        fields = {
            "height": calibration.camera.height,
            "width": calibration.camera.width,
            "distortion_model": "plumb_bob",
            "d": np.array(calibration.camera.distortion),
            "k": np.array(calibration.k),
            "r": np.array(content.IDENTITY),
            "p": np.array(calibration.p),
            "binning_x": 0,
            "binning_y": 0,
            "roi": whole,
        }
        return self._message("sensor_msgs/msg/CameraInfo", time_ns, content.CAMERA, fields)

    def pose(self, time_ns: int, pose: content.CameraPose) -> content.EncodedMessage:
        """Odometry of the camera in the world; twist unknown."""
        x, y, z, w = map(float, pose.quaternion)
        orientation = self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        position = self._xyz("geometry_msgs/msg/Point", pose.position)
        rest = self._xyz("geometry_msgs/msg/Vector3", np.zeros(3))
        unknown = np.array([_UNKNOWN, *[0.0] * 35])
        fields = {
            "child_frame_id": content.CAMERA,
            "pose": self._make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self._make(
                    "geometry_msgs/msg/Pose", position=position, orientation=orientation
                ),
                covariance=pose.covariance(),
            ),
            "twist": self._make(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=self._make("geometry_msgs/msg/Twist", linear=rest, angular=rest),
                covariance=unknown,
            ),
        }
        return self._message("nav_msgs/msg/Odometry", time_ns, content.WORLD, fields)

    def fix(self, time_ns: int, fix: content.FixReading) -> content.EncodedMessage:
        """Position fix."""
        fields = {
            "status": self._make("sensor_msgs/msg/NavSatStatus", status=0, service=1),
            "latitude": fix.latitude,
            "longitude": fix.longitude,
            "altitude": fix.altitude,
            "position_covariance": np.array(fix.covariance()),
            "position_covariance_type": content.DIAGONAL_KNOWN,
        }
        return self._message("sensor_msgs/msg/NavSatFix", time_ns, content.ANTENNA, fields)
