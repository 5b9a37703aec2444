"""Whether the calibration of a run can be right, by those parts of the drive that turn most."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import acos, sqrt
from typing import NamedTuple

import numpy as np
from scipy import stats

from wayside.schemas.frame import Camera
from wayside.schemas.motion import Motion, PosedDetections
from wayside.schemas.settings import LocalAdjustmentSettings, TieSettings
from wayside.schemas.settings.calibration import SelfCalibrationSettings
from wayside.stages.calibration.drive_fit import calibrate_drive, lens_step
from wayside.stages.calibration.lens import RADIAL, displacement
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
) -> Iterator[LensCheck]:
    """What each watched drive says of its lens, after its last image."""
    for watch in watches:
        yield watch.check(ties, adjustment)


class LensCheck(NamedTuple):
    """What a drive says of the lens it was processed with.

    correction: relative change of the focal length that it asks for, to first order, and its standard error sigma
    (None: it says nothing); found: the camera by the drive, with k1 and k2, where the one given cannot be right.
    """

    correction: float | None
    sigma: float | None
    found: Camera | None


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

    def check(self, ties: TieSettings, adjustment: LocalAdjustmentSettings) -> LensCheck:
        """Compare the lens with that of the segments kept.

        It cannot be right where the adjustment of `calibrate_drive` exceeds both limits of the settings: a chi-square
        test of focal length, k1 and k2 together, since their errors are correlated, and the displacement of points.
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
) -> LensCheck:
    s, sigma_px = settings, settings.principal_point * camera.width
    step, covariance = lens_step(segments, camera, sigma_px, ties, adjustment, s)
    if not (np.isfinite(step).all() and np.isfinite(covariance).all()):
        return _NOTHING
    correction, sigma = float(step[0]), sqrt(float(covariance[0, 0]))
    if displacement(camera, step) <= s.check_closer * s.check_error:
        return LensCheck(correction, sigma, None)
    found = calibrate_drive(segments, camera, sigma_px, ties, adjustment, s)
    change, errors = found.lens[RADIAL], found.covariance[np.ix_(RADIAL, RADIAL)]
    by_chance = float(stats.chi2.sf(change @ np.linalg.solve(errors, change), len(RADIAL)))
    significant = by_chance < 2 * stats.norm.sf(s.check_sigmas)
    wrong = significant and displacement(camera, found.lens) > s.check_error
    return LensCheck(correction, sigma, found.camera if wrong else None)


_NOTHING = LensCheck(None, None, None)
