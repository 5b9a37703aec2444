"""The lens of a camera by the log of a drive, and words on the calibration given.

A run makes the same estimate of its images (`CalibrationWatch`).
"""

from dataclasses import dataclass, replace
from pathlib import Path

from wayside.pipeline.reading.calibrations import read_camera_file
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.plan import make_plan
from wayside.pipeline.reading.survey import LogSurvey, survey_log
from wayside.schemas.detections import Candidates, Detections, Regions
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings, Settings
from wayside.stages.calibration import (
    CalibrationWatch,
    DriveCalibration,
    describe_calibration,
    watch_calibration,
)
from wayside.stages.imaging import decode
from wayside.stages.odometry import estimate_motion, extract_features
from wayside.stages.segmentation import unsegmented

UNKNOWN_PRINCIPAL_POINT_SIGMA = 0.02
"""Scatter about the centre of the image where no calibration is given, by the width: 1 % to 2.3 % in KITTI."""
FOCAL_GUESSES = (0.6, 0.9, 1.4)
"""Focal lengths by the width that are tried where no calibration is given: 80, 58 and 39 degrees across."""
_SOME_CAMERA = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class CalibratedDrive:
    """A calibration by a log."""

    log: Path
    source: str
    """Of the calibration given. Empty: none was."""
    calibration: DriveCalibration

    @property
    def headline(self) -> str:
        """What the calibration was made of, in a line."""
        c = self.calibration
        return (
            f"{self.log.name}: {c.ties} ties in the {c.segments} parts of the drive that turn most; "
            f"residual {c.residual:.2f} times that expected of sharp images"
        )

    def parameter_lines(self) -> list[str]:
        """Each parameter with its standard error, and what was given."""
        lines = [f"{'parameter':<10}{'value':>12}{'standard error':>18}{'given':>12}"]
        for name, one in self.calibration.parameters.items():
            was = f"{one.given:.6g}" if self.source else "-"
            lines.append(f"{name:<10}{one.value:12.6g}{one.sigma:18.3g}{was:>12}")
        return lines

    def require_determined(self) -> None:
        """Raise InputError where the drive does not determine the focal length."""
        if not self.calibration.is_determined:
            raise InputError(
                f"{self.log}: {describe_calibration(self.calibration, self.source)}. Straight driving does not "
                "determine the focal length. Take a drive with curves, with poses if there are any, or photograph a "
                "board (wayside calibrate IMAGES --board 9x6)."
            )


def format_drive(found: CalibratedDrive) -> str:
    """Parameters with standard errors, and whether the camera given agrees."""
    words = describe_calibration(found.calibration, found.source)
    return "\n".join([found.headline, "", *found.parameter_lines(), "", words])


def calibrate_log(log: Path, settings: Settings) -> CalibratedDrive:
    """Estimate the lens of a log's camera from its images and its poses, where it has them.

    Matching starts from the given calibration. Without one it starts from several focal lengths, and once more from the
    best result. `settings`: which images are read, and how they are matched. Raises UsageError and InputError where the
    log cannot be read, or too few of its images could be matched.
    """
    read, source, size = _plan(log, settings.read)
    settings = replace(settings, read=read)
    if source:
        found = _estimate(log, None, settings)
    else:
        width, height = size
        guesses = [
            Camera(width, height, one * width, one * width, (width - 1) / 2, (height - 1) / 2)
            for one in FOCAL_GUESSES
        ]
        tried = [one for one in (_estimate(log, guess, settings) for guess in guesses) if one]
        found = min(tried, key=lambda one: one.cost * one.residual**2, default=None)
        if found is not None:
            # The distortion stays the one of the start, because the prior describes it.
            start = replace(found.given, fx=found.camera.fx, fy=found.camera.fy)
            found = _estimate(log, start, settings) or found
    if found is None:
        raise InputError(
            f"{log}: the images have too few points in common to calibrate by. Take a part of the drive with texture, "
            "light and curves, with --from and --until."
        )
    return CalibratedDrive(log, source, found)


def _estimate(log: Path, guess: Camera | None, settings: Settings) -> DriveCalibration | None:
    """The estimate of a run, by the calibration given or a guess; None where the images determine nothing."""
    watch = CalibrationWatch()
    if guess is not None:
        watch.principal_sigma = UNKNOWN_PRINCIPAL_POINT_SIGMA
    images = decode(read_frames(log, settings.read, ReadReport(), guess), settings.balance)
    bare = (Detections(unsegmented(one), Candidates.of(Regions.empty())) for one in images)
    motions = estimate_motion(extract_features(bare, settings.features), settings.motion)
    for _ in watch_calibration(motions, watch):
        pass
    return watch.calibrate()


def _plan(log: Path, settings: ReadSettings) -> tuple[ReadSettings, str, tuple[int, int]]:
    """Settings by which the log can be read, the source of the calibration given, and the size of the images."""
    survey = survey_log(log, settings.camera)
    try:
        plan = make_plan(survey, settings, _SOME_CAMERA)
    except InputError:
        if settings.spacing_m > 0:
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
    return settings, _source(survey, settings), size


def _source(survey: LogSurvey, settings: ReadSettings) -> str:
    """Source of the calibration that the user or the log names; empty without one."""
    given = read_camera_file(Path(settings.calibration)) if settings.calibration else None
    try:
        return make_plan(survey, settings, given).calibration_source
    except InputError:  # a log without calibration
        return ""
