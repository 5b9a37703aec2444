"""Contents of the ROS 2 messages, unpacked from CDR or JSON.

Field names and meanings: https://docs.ros.org/en/humble/p/sensor_msgs
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from wayside.pipeline.reading.contents import (
    VAGUEST_M,
    CalibrationContent,
    ContentError,
    FixContent,
    ImageContent,
    PoseContent,
    check_video_format,
    make_camera,
    make_fix,
    refused_variances,
    stamp_ns,
)
from wayside.pipeline.reading.h264 import H264

_NO_FIX = -1


def compressed_image(message: Any, data: memoryview) -> list[ImageContent]:
    """`sensor_msgs/msg/CompressedImage`; its format is free text such as "bgr8; jpeg compressed bgr8"."""
    return [ImageContent(_time(message), _name(message), message.format, data)]


def compressed_video(message: Any, data: memoryview) -> list[ImageContent]:
    """`foxglove_msgs/msg/CompressedVideo`, as `foxglove.CompressedVideo` with times of ROS."""
    stamp = message.timestamp
    check_video_format(message.format)
    return [ImageContent(stamp_ns(stamp.sec, stamp.nanosec), message.frame_id, H264, data)]


def image(message: Any, data: memoryview) -> list[ImageContent]:
    """`sensor_msgs/msg/Image`."""
    m = message
    return [ImageContent(_time(m), _name(m), m.encoding, data, m.width, m.height, m.step)]


def camera_info(message: Any, _: memoryview) -> list[CalibrationContent]:
    """`sensor_msgs/msg/CameraInfo`: matrix of the full sensor, brought to the binned part that the images show."""
    m = message
    try:
        k = [float(v) for v in _either(m, "k", "K")]
        if len(k) != 9:
            raise ContentError("its camera matrix is not 3 x 3")
        roi = getattr(m, "roi", None)
        bin_x, bin_y = getattr(m, "binning_x", 0) or 1, getattr(m, "binning_y", 0) or 1
        left, top = (0, 0) if roi is None else (roi.x_offset, roi.y_offset)
        width = (m.width if roi is None or not roi.width else roi.width) // bin_x
        height = (m.height if roi is None or not roi.height else roi.height) // bin_y
        k[0], k[2] = k[0] / bin_x, (k[2] - left) / bin_x
        k[4], k[5] = k[4] / bin_y, (k[5] - top) / bin_y
        d = tuple(float(v) for v in _either(m, "d", "D"))
        camera = make_camera((width, height), tuple(k), m.distortion_model, d)
    except ContentError as error:
        return [CalibrationContent(_time(m), _name(m), None, str(error))]
    return [CalibrationContent(_time(m), _name(m), camera)]


def pose_stamped(message: Any, _: memoryview) -> list[PoseContent]:
    """`geometry_msgs/msg/PoseStamped`."""
    return [_pose(message, "", message.pose.position, message.pose.orientation)]


def transforms(message: Any, _: memoryview) -> list[PoseContent]:
    """`tf2_msgs/msg/TFMessage`."""
    return [
        _pose(one, one.child_frame_id, one.transform.translation, one.transform.rotation)
        for one in message.transforms
    ]


def transform_stamped(message: Any, _: memoryview) -> list[PoseContent]:
    """`geometry_msgs/msg/TransformStamped`."""
    m = message
    return [_pose(m, m.child_frame_id, m.transform.translation, m.transform.rotation)]


def odometry(message: Any, _: memoryview) -> list[PoseContent]:
    """`nav_msgs/msg/Odometry`, with the sigmas of its pose covariance (x, y, z, then rotations about them)."""
    m, pose = message, message.pose.pose
    sigma_m, sigma_rad, refused = None, None, ""
    if len(message.pose.covariance) == 36:
        variances = [float(variance) for variance in message.pose.covariance[::7]]
        refused = refused_variances(variances)
        sigma_m, sigma_rad = _sigma(variances[:3]), _sigma(variances[3:])
    content = _pose(m, m.child_frame_id, pose.position, pose.orientation)
    return [replace(content, sigma_m=sigma_m, sigma_rad=sigma_rad, refused=refused)]


def nav_sat_fix(message: Any, _: memoryview) -> list[FixContent]:
    """`sensor_msgs/msg/NavSatFix`; nothing while the receiver has no fix."""
    m = message
    status = getattr(m, "status", None)
    if status is not None and status.status == _NO_FIX:
        return []
    known = getattr(m, "position_covariance_type", 0)
    covariance = tuple(float(v) for v in m.position_covariance) if known else None
    return make_fix(_time(m), m.latitude, m.longitude, m.altitude, covariance)


def _sigma(variances: list[float]) -> float | None:
    """Root of the mean variance; None where it is unknown (zero, negative, infinite, or `VAGUEST_M` and more)."""
    if not min(variances) > 0 or not sum(variances) / 3 < VAGUEST_M**2:
        return None
    return math.sqrt(sum(variances) / 3)


def _pose(message: Any, child: str, position: Any, orientation: Any) -> PoseContent:
    p, q = position, orientation
    turn, shift = (q.x, q.y, q.z, q.w), (p.x, p.y, p.z)
    return PoseContent(_time(message), _name(message), child, turn, shift)


def _either(message: Any, name: str, older: str) -> Any:
    """A field that JSON writers name in the way of ROS 2 or of ROS 1."""
    return getattr(message, name) if hasattr(message, name) else getattr(message, older)


def _time(message: Any) -> int | None:
    """Nanoseconds of the header's stamp, None where it is not set."""
    stamp = message.header.stamp
    nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec
    return stamp_ns(stamp.sec, nanoseconds)


def _name(message: Any) -> str:
    return str(message.header.frame_id)
