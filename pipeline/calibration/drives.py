"""The log of a drive to a camera: images are matched as in a run, and the lens adjusted to their tracks.

The result in words says what it makes of the calibration that was given.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from wayside.pipeline.reading.calibrations import read_camera_file
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.plan import check_settings, make_plan
from wayside.pipeline.reading.survey import LogSurvey, survey_log
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.motion import Motion
from wayside.schemas.settings import ReadSettings, Settings
from wayside.stages.calibration import (
    LENS,
    PRINCIPAL_POINT_SIGMA,
    DriveCalibration,
    calibrate_drive,
    changed_camera,
    cut_segments,
)
from wayside.stages.geometry import ideal_points
from wayside.stages.imaging import decode
from wayside.stages.odometry import KeypointImage, VisualOdometry, tie_corners

MOST_IMAGES = 300
"""Images of a log that are used, from its start or --from on."""
UNKNOWN_PRINCIPAL_POINT_SIGMA = 0.02
"""Scatter about the centre of the image where no calibration is given, by the width: 1 % to 2.3 % in KITTI."""
FOCAL_GUESSES = (0.6, 0.9, 1.4)
"""Focal lengths by the width that are tried where no calibration is given: 80, 58 and 39 degrees across."""
ROUNDS = 3
"""Rounds of matching anew with the result at most."""
SETTLED = 0.02
"""Matching is repeated where the focal length changed by more."""
LARGEST_SIGMA = 0.03
"""A focal length with a larger relative standard error is not determined: so large is that of positions."""
_SOME_CAMERA = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class CalibratedDrive:
    """A calibration by a log."""

    log: Path
    given: Camera | None
    """The camera that the log or the user names, if any."""
    source: str
    """Of that."""
    images: int
    """Those that were matched."""
    calibration: DriveCalibration

    @property
    def headline(self) -> str:
        """What the calibration was made of, in a line."""
        c = self.calibration
        return (
            f"{self.log.name}: {self.images} images, {c.ties} ties in {c.segments} segments; "
            f"residual {c.residual:.2f} times that expected of sharp images"
        )

    def parameter_lines(self) -> list[str]:
        """Each parameter with its standard error, and what was given."""
        values = _parameters(self.calibration.camera)
        was = ["-"] * len(values)
        if self.given is not None:
            old = changed_camera(self.given, np.zeros(len(LENS)))
            was = [f"{value:.6g}" for value in _parameters(old)]
        errors = np.sqrt(np.diag(self.calibration.covariance))[[0, 0, 1, 2, 3, 4]]
        lines = [f"{'parameter':<10}{'value':>12}{'standard error':>18}{'given':>12}"]
        for k, name in enumerate(("fx", "fy", "cx", "cy", "k1", "k2")):
            error = errors[k] * (values[k] if k < 2 else 1.0)  # of a focal length it is relative
            lines.append(f"{name:<10}{values[k]:12.6g}{error:18.3g}{was[k]:>12}")
        return lines

    def require_determined(self) -> None:
        """Raise InputError where the drive does not determine the focal length."""
        sigma = self.calibration.focal_sigma
        if sigma > LARGEST_SIGMA:
            raise InputError(
                f"{self.log}: the focal length has a standard error of {100 * sigma:.2f} % ({self.headline}), which "
                f"must be at most {100 * LARGEST_SIGMA:g} %. Straight driving does not determine the focal length. "
                "Take a drive with curves, with poses if there are any, or photograph a board (wayside calibrate "
                "IMAGES --board 9x6)."
            )


def _parameters(camera: Camera) -> list[float]:
    return [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion[:2]]


def format_drive(found: CalibratedDrive) -> str:
    """Parameters with standard errors, and whether the camera given agrees."""
    words = "no calibration was given; centre of the image taken as principal point"
    if found.given is not None:
        off = found.given.fx / found.calibration.camera.fx - 1
        sigmas = abs(off) / found.calibration.focal_sigma
        words = (
            f"the focal length given ({found.source}) is {100 * abs(off):.1f} % "
            f"{'longer' if off > 0 else 'shorter'}, {sigmas:.1f} standard errors: "
            f"{'it agrees' if sigmas <= 2 else 'it does not agree'}"
        )
    return "\n".join([found.headline, "", *found.parameter_lines(), "", words])


def calibrate_log(log: Path, settings: Settings) -> CalibratedDrive:
    """Estimate the lens of a log's camera from its images and its poses, where it has them.

    Matching starts from the given calibration, or from several focal lengths. It is repeated with the result while that
    changes much. settings: which images are read, and how they are matched. Raises UsageError and InputError where the
    log cannot be read, or too few of its images could be matched.
    """
    read, given, source, size = _plan(log, settings.read)
    settings = replace(settings, read=read)
    width, height = size
    if given is not None:
        starts, scatter = [given], PRINCIPAL_POINT_SIGMA
    else:
        centre = (width - 1) / 2, (height - 1) / 2
        focals = [guess * width for guess in FOCAL_GUESSES]
        starts = [Camera(width, height, f, f, *centre) for f in focals]
        scatter = UNKNOWN_PRINCIPAL_POINT_SIGMA
    start, (images, found) = _best_start(log, starts, scatter * width, settings)
    for _ in range(ROUNDS - 1):
        if abs(found.camera.fx / start.fx - 1) < SETTLED:
            break
        # The distortion stays that of the start: what is known beforehand is known of it.
        ratio = found.camera.fx / start.fx
        start = replace(start, fx=start.fx * ratio, fy=start.fy * ratio)
        images, found = _round(log, start, scatter * width, settings)
    return CalibratedDrive(log, given, source, images, found)


def _best_start(
    log: Path, starts: Sequence[Camera], principal_sigma_px: float, settings: Settings
) -> tuple[Camera, tuple[int, DriveCalibration]]:
    """The camera to start from whose ties fit best, with its first round; raises InputError where none has any."""
    rounds, errors = [], []
    for start in starts:
        try:
            rounds.append((start, _round(log, start, principal_sigma_px, settings)))
        except InputError as error:  # matching may fail from a focal length that is far off
            errors.append(error)
    if not rounds:
        raise errors[0]
    return min(rounds, key=lambda one: one[1][1].cost * one[1][1].residual ** 2)


def _round(
    log: Path, camera: Camera, principal_sigma_px: float, settings: Settings
) -> tuple[int, DriveCalibration]:
    """Images used, and the calibration by ties that were matched with a camera."""
    motions = list(islice(_motions(log, camera, settings), MOST_IMAGES))
    segments = cut_segments(motions, camera)
    if not segments:
        raise InputError(
            f"{log}: none of the {len(motions)} images used have points in common to calibrate by. Take a part of the "
            "drive with texture and light, with --from and --until."
        )
    try:
        found = calibrate_drive(segments, camera, principal_sigma_px)
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"{log}: the tie points of this drive do not determine the focal length. Take another part of it, with "
            "curves."
        ) from error
    return len(motions), found


def _motions(log: Path, camera: Camera, settings: Settings) -> Iterator[Motion]:
    odometry = VisualOdometry(settings.motion)
    for image in decode(read_frames(log, settings.read, ReadReport(), camera)):
        if image.frame.used and image.grey is not None:
            corners, descriptors = tie_corners(image.grey, settings.features)
            ideal = ideal_points(camera, corners)
            points = KeypointImage(camera, image.grey, corners, descriptors, ideal)
            yield odometry.advance(points, image.frame)


def _plan(
    log: Path, settings: ReadSettings
) -> tuple[ReadSettings, Camera | None, str, tuple[int, int]]:
    """Settings by which the log can be read, the camera given and its source, and the size of the images."""
    check_settings(settings)
    spaced = settings.spacing_m > 0
    survey = survey_log(log, settings.camera)
    try:
        plan = make_plan(survey, settings, _SOME_CAMERA)
    except InputError:
        if spaced:
            raise
        # The lens does not depend on the lengths of steps: any will do.
        settings = replace(settings, spacing_m=max(settings.thin_m, 1.0))
        plan = make_plan(survey, settings, _SOME_CAMERA)
    size = plan.camera.image_size
    if size is None:
        raise InputError(
            f"{log}: the messages of {plan.camera.name} do not state the size of the images. Give a calibration with "
            "--calibration camera.yaml."
        )
    return settings, *_given(survey, settings), size


def _given(survey: LogSurvey, settings: ReadSettings) -> tuple[Camera | None, str]:
    """The camera that the user or the log names, and its source."""
    if settings.calibration:
        return read_camera_file(Path(settings.calibration)), settings.calibration
    try:
        plan = make_plan(survey, settings, None)
    except InputError:  # a log without calibration
        return None, ""
    return plan.first_camera, plan.calibration_source
