"""Contents of the Foxglove schemas, unpacked from protobuf or JSON.

Field names and meanings: https://docs.foxglove.dev/docs/sdk/schemas
"""

from __future__ import annotations

from typing import Any

from wayside.pipeline.reading.contents import (
    CalibrationContent,
    ContentError,
    FixContent,
    ImageContent,
    PoseContent,
    check_video_format,
    make_camera,
    make_fix,
    stamp_ns,
)
from wayside.pipeline.reading.h264 import H264


def compressed_image(message: Any, data: memoryview) -> list[ImageContent]:
    """`foxglove.CompressedImage`."""
    return [ImageContent(_time(message), _name(message), message.format, data)]


def compressed_video(message: Any, data: memoryview) -> list[ImageContent]:
    """`foxglove.CompressedVideo`: one picture of an H.264 stream."""
    check_video_format(message.format)
    return [ImageContent(_time(message), _name(message), H264, data)]


def raw_image(message: Any, data: memoryview) -> list[ImageContent]:
    """`foxglove.RawImage`."""
    m = message
    return [ImageContent(_time(m), _name(m), m.encoding, data, m.width, m.height, m.step)]


def calibration(message: Any, _: memoryview) -> list[CalibrationContent]:
    """`foxglove.CameraCalibration`."""
    m = message
    try:
        camera = make_camera(
            (m.width, m.height),
            tuple(map(float, m.K)),
            getattr(m, "distortion_model", ""),
            tuple(map(float, getattr(m, "D", ()))),
        )
    except ContentError as error:
        return [CalibrationContent(_time(m), _name(m), None, str(error))]
    return [CalibrationContent(_time(m), _name(m), camera)]


def pose_in_frame(message: Any, _: memoryview) -> list[PoseContent]:
    """`foxglove.PoseInFrame`."""
    return [_pose(message, message.pose)]


def poses_in_frame(message: Any, _: memoryview) -> list[PoseContent]:
    """`foxglove.PosesInFrame`: the first, which is the one at its time stamp."""
    return [_pose(message, pose) for pose in message.poses[:1]]


def frame_transform(message: Any, _: memoryview) -> list[PoseContent]:
    """`foxglove.FrameTransform`."""
    m, r, t = message, message.rotation, message.translation
    return [
        PoseContent(
            _time(m),
            m.parent_frame_id,
            m.child_frame_id,
            (r.x, r.y, r.z, r.w),
            (t.x, t.y, t.z),
        )
    ]


def frame_transforms(message: Any, data: memoryview) -> list[PoseContent]:
    """`foxglove.FrameTransforms`."""
    return [pose for one in message.transforms for pose in frame_transform(one, data)]


def location_fix(message: Any, _: memoryview) -> list[FixContent]:
    """`foxglove.LocationFix`; covariance type 0 means unknown."""
    m = message
    known = getattr(m, "position_covariance_type", 0)
    covariance = tuple(map(float, m.position_covariance)) if known else None
    return make_fix(_time(m), m.latitude, m.longitude, m.altitude, covariance)


def _pose(message: Any, pose: Any) -> PoseContent:
    p, q = pose.position, pose.orientation
    return PoseContent(_time(message), _name(message), "", (q.x, q.y, q.z, q.w), (p.x, p.y, p.z))


def _time(message: Any) -> int | None:
    """Nanoseconds of the time stamp (protobuf `seconds, nanos`; JSON `sec, nsec`), None where it is not set."""
    stamp = getattr(message, "timestamp", None)
    if stamp is None:
        return None
    if hasattr(stamp, "seconds"):
        return stamp_ns(stamp.seconds, stamp.nanos)
    return stamp_ns(stamp.sec, stamp.nsec)


def _name(message: Any) -> str:
    return str(getattr(message, "frame_id", ""))
