"""The parts of a drive that turn most, by which its lens is estimated."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import acos

import numpy as np

from wayside.schemas.frame import Camera
from wayside.schemas.motion import Motion, PosedDetections
from wayside.stages.calibration.drive_fit import (
    PRINCIPAL_POINT_SIGMA,
    DriveCalibration,
    calibrate_drive,
)
from wayside.stages.calibration.segment import SEGMENT_IMAGES, cut_segments

WATCHED_SEGMENTS = 6
"""Segments of a drive by which its lens is estimated: 0.1 s to 0.5 s each. More hardly lower its standard error."""
WATCHED_CELL = 1 / 16
"""One tie is taken in each cell of this size, by the width: nearer ones share most of their errors."""


def watch_calibration(
    images: Iterator[PosedDetections], watch: "CalibrationWatch"
) -> Iterator[PosedDetections]:
    """Pass images on as they are, and keep of their motion what an estimate of the lens takes."""
    for item in images:
        if item.motion is not None and item.frame.camera is not None:
            watch.add(item.motion, item.frame.camera)
        yield item


def check_calibration(watches: "Iterator[CalibrationWatch]") -> Iterator[DriveCalibration]:
    """What each watched drive says of its lens, after its last image; nothing where its ties determine nothing."""
    for watch in watches:
        found = watch.calibrate()
        if found is not None:
            yield found


@dataclass(slots=True)
class CalibrationWatch:
    """Motions of the segments that turn most, `most` segments of so many images; the first camera counts."""

    camera: Camera | None = None
    current: list[Motion] = field(default_factory=list)
    kept: list[tuple[float, list[Motion]]] = field(default_factory=list)
    images: int = SEGMENT_IMAGES
    most: int = WATCHED_SEGMENTS
    principal_sigma: float = PRINCIPAL_POINT_SIGMA
    """Of that camera, by its width."""

    def add(self, motion: Motion, camera: Camera) -> None:
        """Take note of the next used image."""
        self.camera = camera if self.camera is None else self.camera
        if camera != self.camera:
            self.current = []
            return
        self.current.append(motion)
        if len(self.current) == self.images:
            turn = self.current[0].pose.rotation.T @ motion.pose.rotation
            angle = acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(turn)) - 1))))
            self.kept.append((angle, self.current))
            # The sort is stable: of equal angles the earlier stays.
            self.kept.sort(key=lambda one: -one[0])
            del self.kept[self.most :]
            self.current = [motion]

    def calibrate(self) -> DriveCalibration | None:
        """Estimate the lens by the segments kept; None where their ties determine nothing."""
        parts, camera = [motions for _, motions in self.kept] or [self.current], self.camera
        if camera is None:
            return None
        cell_px = WATCHED_CELL * camera.width
        found = (cut_segments(part, camera, self.images, cell_px) for part in parts)
        segments = [one for part in found for one in part]
        try:
            sigma_px = self.principal_sigma * camera.width
            return calibrate_drive(segments, camera, sigma_px) if segments else None
        except np.linalg.LinAlgError:
            return None
