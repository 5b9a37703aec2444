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
from wayside.stages.calibration.drive_fit import DriveCalibration, describe_calibration
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
    "check_calibration",
    "describe_calibration",
    "find_board",
    "format_residuals",
    "watch_calibration",
]
