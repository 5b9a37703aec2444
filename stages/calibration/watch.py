"""Whether the calibration of a run can be right, by those parts of the drive that turn most."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import acos, sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtr

from wayside.schemas.frame import Camera
from wayside.schemas.motion import Motion, PosedDetections
from wayside.stages.calibration.drive_fit import (
    PRINCIPAL_POINT_SIGMA,
    calibrate_from,
    lens_step,
    start_of,
)
from wayside.stages.calibration.segment import SEGMENT_IMAGES, Segment, cut_segments
from wayside.stages.calibration.segment_equations import RADIAL, displacement

CHECK_SEGMENTS = 3
"""Segments of a run by which its calibration is checked, those that turn most: 0.05 s to 0.15 s each."""
CHECK_CELL = 1 / 16
"""The check takes one tie in each cell of this size, by the width: nearer ones share most of their errors."""
CHECK_ERROR = 0.03
"""A lens is wrong where a point is displaced by more, by its distance from the principal point."""
CHECK_CLOSER = 0.5
"""The full fit follows where the first step, which falls short, displaces a point by so much of `CHECK_ERROR`."""
CHECK_SIGMAS = 4.0
"""A lens is wrong where a chi-square test of focal length, k1 and k2 rejects it at so many standard deviations."""


def watch_calibration(
    images: Iterator[PosedDetections], watch: CalibrationWatch
) -> Iterator[PosedDetections]:
    """Pass images on as they are, and keep of their motion what a check of the calibration takes."""
    for item in images:
        if item.motion is not None and item.frame.camera is not None:
            watch.add(item.motion, item.frame.camera)
        yield item


def check_calibration(watches: Iterator[CalibrationWatch]) -> Iterator[LensCheck]:
    """What each watched drive says of its lens, after its last image."""
    for watch in watches:
        yield watch.check()


class LensCheck(NamedTuple):
    """What a drive says of the lens it was processed with.

    `correction`: relative change of the focal length that the drive implies, to first order, and its standard error
    `sigma` (None: unknown). `found`: the camera by the drive, with k1 and k2, where the given one cannot be right.
    """

    correction: float | None = None
    sigma: float | None = None
    found: Camera | None = None


@dataclass(slots=True)
class CalibrationWatch:
    """Motions of the segments that turn most, `most` segments of so many images; the first camera counts."""

    camera: Camera | None = None
    current: list[Motion] = field(default_factory=list)
    kept: list[tuple[float, list[Motion]]] = field(default_factory=list)
    images: int = SEGMENT_IMAGES
    most: int = CHECK_SEGMENTS

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

    def check(self) -> LensCheck:
        """Compare the lens with that of the segments kept.

        It cannot be right where the adjustment of `calibrate_drive` exceeds both limits: a chi-square test and the
        displacement of points. The test is of focal length, k1 and k2 together, because their errors are correlated.
        """
        parts, camera = [motions for _, motions in self.kept] or [self.current], self.camera
        if camera is None:
            return LensCheck()
        cell_px = CHECK_CELL * camera.width
        found = (cut_segments(part, camera, self.images, cell_px) for part in parts)
        segments = [one for part in found for one in part]
        try:
            return _check(segments, camera) if segments else LensCheck()
        except np.linalg.LinAlgError:  # ties that determine nothing
            return LensCheck()


def _check(segments: list[Segment], camera: Camera) -> LensCheck:
    sigma_px = PRINCIPAL_POINT_SIGMA * camera.width
    start = start_of(segments, camera, sigma_px)
    step, covariance = lens_step(start)
    if not (np.isfinite(step).all() and np.isfinite(covariance).all()):
        return LensCheck()
    correction, sigma = float(step[0]), sqrt(float(covariance[0, 0]))
    if displacement(camera, step) <= CHECK_CLOSER * CHECK_ERROR:
        return LensCheck(correction, sigma, None)
    found = calibrate_from(start)
    change, errors = found.lens[RADIAL], found.covariance[np.ix_(RADIAL, RADIAL)]
    by_chance = float(chdtrc(len(RADIAL), change @ np.linalg.solve(errors, change)))
    significant = by_chance < 2 * ndtr(-CHECK_SIGMAS)
    wrong = significant and displacement(camera, found.lens) > CHECK_ERROR
    return LensCheck(correction, sigma, found.camera if wrong else None)
