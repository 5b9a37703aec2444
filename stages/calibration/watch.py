"""Whether the calibration of a run can be right, by those parts of the drive that turn most."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import acos, exp, isfinite
from typing import NamedTuple

import numpy as np

from wayside.schemas.frame import Camera
from wayside.schemas.motion import Motion, PosedDetections
from wayside.schemas.settings import LocalAdjustmentSettings, TieSettings
from wayside.schemas.settings.calibration import SelfCalibrationSettings
from wayside.stages.calibration.drive_fit import calibrate_drive, focal_correction
from wayside.stages.calibration.segment import Segment, cut_segments


def watch_calibration(
    images: Iterator[PosedDetections], watch: CalibrationWatch
) -> Iterator[PosedDetections]:
    """Pass images on as they are, and keep of their motion what a check of the calibration takes."""
    for item in images:
        if item.motion is not None and item.frame.camera is not None:
            watch.add(item.motion, item.frame.camera)
        yield item


def check_calibration(
    watches: Iterator[CalibrationWatch], *, ties: TieSettings, adjustment: LocalAdjustmentSettings
) -> Iterator[FocalCheck]:
    """What each watched drive says of its focal length, after its last image."""
    for watch in watches:
        yield watch.check(ties, adjustment)


class FocalCheck(NamedTuple):
    """What a drive says of the focal length it was processed with.

    correction: relative change that it asks for, to first order, and its standard error sigma (None: it says nothing);
    error: how much too long the focal length is, relatively, where it cannot be right, else None.
    """

    correction: float | None
    sigma: float | None
    error: float | None


@dataclass(slots=True)
class CalibrationWatch:
    """Motions of the segments that turn most, of bounded number; the camera of the first image counts."""

    settings: SelfCalibrationSettings = field(default_factory=SelfCalibrationSettings)
    camera: Camera | None = None
    current: list[Motion] = field(default_factory=list)
    kept: list[tuple[float, list[Motion]]] = field(default_factory=list)

    def add(self, motion: Motion, camera: Camera) -> None:
        """Take note of the next used image."""
        self.camera = camera if self.camera is None else self.camera
        if camera != self.camera:
            self.current = []
            return
        self.current.append(motion)
        if len(self.current) == self.settings.images:
            self._keep()
            self.current = [motion]

    def _keep(self) -> None:
        turn = self.current[0].pose.rotation.T @ self.current[-1].pose.rotation
        angle = acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(turn)) - 1))))
        self.kept.append((angle, self.current))
        # The sort is stable: of equal angles the earlier stays.
        self.kept.sort(key=lambda one: -one[0])
        del self.kept[self.settings.check_segments :]

    def check(self, ties: TieSettings, adjustment: LocalAdjustmentSettings) -> FocalCheck:
        """Compare the focal length with that of the segments kept.

        It cannot be right where the adjustment of `calibrate_drive` exceeds both limits of the settings.
        """
        parts = [motions for _, motions in self.kept] or [self.current]
        camera, s = self.camera, self.settings
        if camera is None:
            return _NOTHING
        segments = [
            one for part in parts for one in cut_segments(part, camera, ties, adjustment, s)
        ]
        if not segments:
            return _NOTHING
        try:
            return _check(segments, camera, ties, adjustment, s)
        except np.linalg.LinAlgError:  # ties that determine nothing
            return _NOTHING


def _check(
    segments: list[Segment],
    camera: Camera,
    ties: TieSettings,
    adjustment: LocalAdjustmentSettings,
    settings: SelfCalibrationSettings,
) -> FocalCheck:
    s, sigma_px = settings, settings.principal_point * camera.width
    correction, sigma = focal_correction(segments, camera, sigma_px, ties, adjustment, s)
    if not (isfinite(correction) and isfinite(sigma)):
        return _NOTHING
    if abs(correction) <= s.check_closer * s.check_error:
        return FocalCheck(correction, sigma, None)
    found = calibrate_drive(segments, camera, sigma_px, ties, adjustment, s)
    error = -float(found.lens[0])
    limit = max(s.check_error, s.check_sigmas * found.focal_sigma)
    return FocalCheck(correction, sigma, exp(error) - 1 if abs(error) > limit else None)


_NOTHING = FocalCheck(None, None, None)
