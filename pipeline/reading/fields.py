"""Contents of the messages of Foxglove and of ROS, which name most of their fields alike, unpacked from any encoding.

Field names and meanings: https://docs.foxglove.dev/docs/sdk/schemas, https://docs.ros.org/en/humble/p/sensor_msgs
"""

from __future__ import annotations

import math
from typing import Any

from wayside.pipeline.reading.calibrations import Region, make_calibration
from wayside.pipeline.reading.contents import (
    VAGUEST_M,
    CalibrationContent,
    ContentError,
    FixContent,
    ImageContent,
    PoseContent,
    make_fix,
    stamp_ns,
)
from wayside.pipeline.reading.h264 import H264

_NO_FIX = -1


def compressed_image(message: Any, data: memoryview) -> list[ImageContent]:
    """A compressed image. Its format is free text such as "bgr8, jpeg compressed bgr8"."""
    return [ImageContent(*_head(message), _text(message.format), data)]


def compressed_video(message: Any, data: memoryview) -> list[ImageContent]:
    """One picture of an H.264 stream; raises ContentError where the video is of another format."""
    if message.format.lower() != H264:
        raise ContentError(f"it is video of the format {message.format!r}; h264 is understood")
    return [ImageContent(*_head(message), H264, data)]


def raw_image(message: Any, data: memoryview) -> list[ImageContent]:
    """Rows of pixels."""
    m = message
    encoding = _text(m.encoding)
    if getattr(m, "is_bigendian", 0) and "16" in encoding:
        encoding += " (big-endian)"
    return [ImageContent(*_head(m), encoding, data, m.width, m.height, m.step)]


def calibration(message: Any, _: memoryview) -> list[CalibrationContent]:
    """A calibration; ROS names its matrices in small letters, ROS 1 and Foxglove in capitals."""
    m = message
    k, d, p = (
        tuple(map(float, getattr(m, name, getattr(m, name.upper(), ()))))
        for name in ("k", "d", "p")
    )
    binning = (int(getattr(m, f"binning_{axis}", 0)) or 1 for axis in "xy")
    roi = getattr(m, "roi", None)
    part = (getattr(roi, name, 0) for name in ("x_offset", "y_offset", "width", "height"))
    region = Region(*map(int, part), *binning)
    if min(region) < 0:
        raise ContentError("its region of interest or binning is negative")
    lens = _text(getattr(m, "distortion_model", "")), d
    return [make_calibration(*_head(m), (int(m.width), int(m.height)), k, p, lens, region)]


def pose(message: Any, _: memoryview) -> list[PoseContent]:
    """`foxglove.PoseInFrame`, `geometry_msgs/msg/PoseStamped`."""
    return [_pose(message, message.pose)]


def poses(message: Any, _: memoryview) -> list[PoseContent]:
    """`foxglove.PosesInFrame`: the first, which is the one at its time stamp."""
    return [_pose(message, one) for one in message.poses[:1]]


def transform(message: Any, _: memoryview) -> list[PoseContent]:
    """`foxglove.FrameTransform`, `geometry_msgs/msg/TransformStamped`."""
    m = message
    time_ns, parent = _head(m)
    inner = getattr(m, "transform", m)
    r, t = inner.rotation, inner.translation
    turn, shift = (r.x, r.y, r.z, r.w), (t.x, t.y, t.z)
    parent = _text(getattr(m, "parent_frame_id", parent))
    return [PoseContent(time_ns, parent, _text(m.child_frame_id), turn, shift)]


def transforms(message: Any, data: memoryview) -> list[PoseContent]:
    """`foxglove.FrameTransforms`, `tf2_msgs/msg/TFMessage`."""
    return [content for one in message.transforms for content in transform(one, data)]


def odometry(message: Any, _: memoryview) -> list[PoseContent]:
    """`nav_msgs/msg/Odometry`, with the sigmas of its pose covariance (x, y, z, then rotations about them)."""
    sigma_m, sigma_rad = None, None
    if len(message.pose.covariance) == 36:
        variances = [float(variance) for variance in message.pose.covariance[::7]]
        sigma_m, sigma_rad = _sigma(variances[:3]), _sigma(variances[3:])
    inner = message.pose.pose
    return [_pose(message, inner, _text(message.child_frame_id), sigma_m, sigma_rad)]


def fix(message: Any, _: memoryview) -> list[FixContent]:
    """`foxglove.LocationFix`, `sensor_msgs/msg/NavSatFix`; nothing while the receiver has no fix."""
    m = message
    status = getattr(m, "status", None)
    if status is not None and status.status == _NO_FIX:
        return []
    known = getattr(m, "position_covariance_type", 0)
    covariance = tuple(map(float, m.position_covariance)) if known else None
    return make_fix(_head(m)[0], m.latitude, m.longitude, m.altitude, covariance)


def _sigma(variances: list[float]) -> float | None:
    """Root of the mean variance; None where it is unknown (zero, negative, not a number, `VAGUEST_M` and more)."""
    if not all(variance > 0 for variance in variances) or not sum(variances) / 3 < VAGUEST_M**2:
        return None
    return math.sqrt(sum(variances) / 3)


def _pose(message: Any, pose: Any, child: str = "", *more: Any) -> PoseContent:
    p, q = pose.position, pose.orientation
    return PoseContent(*_head(message), child, (q.x, q.y, q.z, q.w), (p.x, p.y, p.z), *more)


def _head(message: Any) -> tuple[int | None, str]:
    """Time stamp in ns, None where it is not set, and `frame_id`: of a header of ROS, or as Foxglove has them."""
    header = getattr(message, "header", message)
    stamp = getattr(header, "stamp", getattr(header, "timestamp", None))
    time_ns = None
    if stamp is not None:
        seconds = stamp.seconds if hasattr(stamp, "seconds") else stamp.sec
        rest = [getattr(stamp, name, 0) for name in ("nanos", "nanosec", "nsec")]
        time_ns = stamp_ns(seconds, max(rest))
    return time_ns, _text(getattr(header, "frame_id", ""))


def _text(value: str) -> str:
    """The text; raises where JSON holds another type, or half a character."""
    value.encode()
    return value
