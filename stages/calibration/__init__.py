"""Calibration of a camera: by views of a chessboard, and by the point tracks of a drive."""

from wayside.stages.calibration.board_fit import (
    LENS_MODELS,
    Board,
    BoardCalibration,
    CalibrationError,
    FittedView,
    calibrate_boards,
    find_board,
    format_residuals,
)
from wayside.stages.calibration.drive_fit import (
    DriveCalibration,
    calibrate_drive,
    describe_calibration,
)
from wayside.stages.calibration.segment import cut_segments
from wayside.stages.calibration.segment_equations import changed_camera
from wayside.stages.calibration.watch import CalibrationWatch, check_calibration, watch_calibration

__all__ = [
    "LENS_MODELS",
    "Board",
    "BoardCalibration",
    "CalibrationError",
    "CalibrationWatch",
    "DriveCalibration",
    "FittedView",
    "calibrate_boards",
    "calibrate_drive",
    "changed_camera",
    "check_calibration",
    "cut_segments",
    "describe_calibration",
    "find_board",
    "format_residuals",
    "watch_calibration",
]
