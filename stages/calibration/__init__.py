"""Calibration of a camera: by views of a chessboard, and by the point tracks of a drive."""

from wayside.stages.calibration.board_corners import Board, FoundBoard, find_board
from wayside.stages.calibration.board_fit import (
    LENS_MODELS,
    BoardCalibration,
    CalibrationError,
    FittedView,
    Parameter,
    calibrate_boards,
)

__all__ = [
    "LENS_MODELS",
    "Board",
    "BoardCalibration",
    "CalibrationError",
    "FittedView",
    "FoundBoard",
    "Parameter",
    "calibrate_boards",
    "find_board",
]
