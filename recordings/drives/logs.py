"""Writes the MCAP log of a drive."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType, IndexType, Writer

from recordings.drives.arrays import Bytes, Floats
from recordings.drives.geodesy import geodetic
from recordings.drives.messages.content import (
    Calibration,
    CameraPose,
    Dialect,
    EncodedMessage,
    FixReading,
)
from recordings.drives.messages.dialects import DIALECTS, topics
from recordings.drives.poses import TimedPose, quaternion_from_matrix
from recordings.drives.spec import DriveSpec

_COMPRESSIONS = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}
_UP_FACTOR = 1.6
"""Fixes are worse upwards than sideways."""
_FIX_MEMORY = 0.99
_FIX_JITTER = 0.08


@dataclass
class _Channels:
    """Registers schema and channel of a topic with its first message."""

    writer: Writer
    dialect: Dialect
    ids: dict[str, int] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)

    def write(self, topic: str, message: EncodedMessage, header_ns: int, latency_ms: float) -> None:
        name, data = message
        if topic not in self.ids:
            encoding, schema = self.dialect.schema_encoding, self.dialect.schema(name)
            schema_id = self.writer.register_schema(name, encoding, schema)
            self.ids[topic] = self.writer.register_channel(topic, self.dialect.encoding, schema_id)
        self.counts[topic] += 1
        log_ns = header_ns + int(latency_ms * 1e6)
        self.writer.add_message(self.ids[topic], log_ns, data, header_ns, self.counts[topic])


class _Instruments:
    """Noisy poses and fixes of one drive, in the order of its frames."""

    def __init__(self, spec: DriveSpec) -> None:
        self.log = spec.log
        self.rng = np.random.default_rng([spec.seed, 6])
        self.wander = self.rng.normal(0, self.log.fix_sigma_m, 3) * (1, 1, _UP_FACTOR)

    def pose(self, pose: TimedPose) -> CameraPose:
        """True pose with noise."""
        log, rng = self.log, self.rng
        position = pose.position + rng.normal(0, log.pose_sigma_m, 3)
        turn = _rotation(rng.normal(0, np.radians(log.pose_sigma_deg), 3))
        quaternion = quaternion_from_matrix(pose.rotation @ turn)
        return CameraPose(position, quaternion, log.pose_sigma_m, log.pose_sigma_deg)

    def fix(self, pose: TimedPose) -> FixReading:
        """True position with an error that wanders slowly, and a little jitter."""
        sigma, rng = self.log.fix_sigma_m, self.rng
        step = rng.normal(0, sigma * np.sqrt(1 - _FIX_MEMORY**2), 3) * (1, 1, _UP_FACTOR)
        self.wander = _FIX_MEMORY * self.wander + step
        where = pose.position + self.wander + rng.normal(0, _FIX_JITTER * sigma, 3)
        sigmas = (sigma, sigma, _UP_FACTOR * sigma)
        return FixReading(*geodetic(self.log.origin, where), sigmas)


def _rotation(vector: Floats) -> Floats:
    """Rotation matrix of a rotation vector (rad)."""
    return np.asarray(cv2.Rodrigues(vector.reshape(3, 1))[0], np.float64)


def write_log(
    path: Path, spec: DriveSpec, poses: list[TimedPose], images: Iterable[bytes | Bytes]
) -> None:
    """Write all messages of a drive; images are JPEG bytes or bgr8 arrays in frame order."""
    log, dialect = spec.log, DIALECTS[spec.log.dialect]()
    names, instruments = topics(log.dialect, log.raw), _Instruments(spec)
    calibration = Calibration(spec.camera)
    with path.open("wb") as stream:
        writer = Writer(
            stream,
            chunk_size=max(log.chunk_kib, 1) * 1024,
            compression=_COMPRESSIONS[log.compression],
            use_chunking=log.chunk_kib > 0,
            index_types=IndexType.ALL if log.index else IndexType.NONE,
            repeat_channels=log.index,
            repeat_schemas=log.index,
            use_statistics=log.index,
            use_summary_offsets=log.index,
        )
        writer.start(profile="ros2" if log.dialect == "ros2" else "", library="drives")
        channels = _Channels(writer, dialect)
        for pose, image in zip(poses, images, strict=True):
            ns, late = pose.time_ns, log.latency_ms
            channels.write(names.calibration, dialect.calibration(ns, calibration), ns, late * 0.1)
            if log.poses:
                channels.write(names.pose, dialect.pose(ns, instruments.pose(pose)), ns, late * 0.2)
            if log.fixes:
                channels.write(names.fix, dialect.fix(ns, instruments.fix(pose)), ns, late * 0.5)
            message = (
                dialect.compressed(ns, image)
                if isinstance(image, bytes)
                else dialect.raw(ns, image)
            )
            channels.write(names.image, message, ns, late)
        writer.finish()  # type: ignore[no-untyped-call]
