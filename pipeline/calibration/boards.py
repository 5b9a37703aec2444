"""Images of a chessboard to a camera: which images are used, which not and why, and the result in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import cv2
import numpy as np

from wayside.pipeline.files.input_files import read_input
from wayside.pipeline.reading.calibrations import OTHER_LENSES
from wayside.pipeline.reading.image_headers import read_exif, refuse_turned
from wayside.pipeline.reading.image_order import image_files, natural_key
from wayside.schemas.errors import InputError, UsageError
from wayside.stages.calibration import (
    LENS_MODELS,
    Board,
    BoardCalibration,
    CalibrationError,
    FittedView,
    calibrate_boards,
    find_board,
)
from wayside.stages.kernels import Array

Watcher = Callable[[int, int], None]

_AS_STORED = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
"""Images that Exif turns are refused before this makes a difference."""


@dataclass(frozen=True, slots=True)
class BoardImage:
    """An image given."""

    path: Path
    size: tuple[int, int] | None
    """Width and height; None: it cannot be decoded."""
    corners: Array | None
    """(n, 2); None: it has none."""
    why: str = ""
    """Why it has none."""


@dataclass(frozen=True, slots=True)
class CalibratedImages:
    """A calibration with all images given, in natural order of their names; views count those with corners."""

    board: Board
    model: str
    images: tuple[BoardImage, ...]
    calibration: BoardCalibration

    @property
    def seen(self) -> list[tuple[BoardImage, FittedView]]:
        """Images whose corners were found, each with its place in the fit."""
        found = [image for image in self.images if image.corners is not None]
        return [(found[view.index], view) for view in self.calibration.views]

    @property
    def failed(self) -> list[BoardImage]:
        """Images without corners."""
        return [image for image in self.images if image.corners is None]

    @property
    def headline(self) -> str:
        """Images used, board, lens model and residual, in a line."""
        used = sum(view.used for view in self.calibration.views)
        return (
            f"{used} of {len(self.images)} images, board of {self.board.columns} x {self.board.rows} "
            f"inner corners, {self.model}, residual {self.calibration.rms_px:.3f} px RMS"
        )

    def parameter_lines(self) -> list[str]:
        """Each parameter with both standard errors."""
        lines = [f"{'parameter':<10}{'value':>14}{'standard error':>18}{'by views':>14}"]
        for one in self.calibration.parameters:
            spread = f"{one.spread:14.4g}" if isfinite(one.spread) else f"{'-':>14}"
            lines.append(f"{one.name:<10}{one.value:14.6g}{one.sigma:18.4g}{spread}")
        return lines

    def image_lines(self) -> list[str]:
        """Every image with its residual or the reason why it was not used."""
        known = isfinite(self.board.square_m)
        square = self.board.square_m if known else 1.0
        width = max(5, *(len(image.path.name) for image in self.images)) + 2
        heading = "distance m" if known else "distance squares"
        lines = [f"{'image':<{width}}{'residual px':>11}{'tilt deg':>10}{heading:>18}"]
        for image, view in self.seen:
            far = view.distance_squares * square
            note = "" if view.used else "  left out: its residual is far above that of the others"
            lines.append(
                f"{image.path.name:<{width}}{view.rms_px:11.3f}{view.tilt_deg:10.0f}{far:18.2f}{note}"
            )
        lines += [f"{image.path.name:<{width}}not used: {image.why}" for image in self.failed]
        return lines


def parse_board(text: str, square_m: float) -> Board:
    """The board of "9x6": inner corners along both sides. Raises UsageError."""
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal() and min(int(columns), int(rows)) >= 3):
        raise UsageError(
            f"--board: {text!r} is not a number of inner corners. Give the corners along both sides, at least 3 each: "
            "a board of 10 x 7 squares is 9x6."
        )
    return Board(int(columns), int(rows), square_m)


def calibrate_images(
    paths: list[Path], board: Board, model: str, watch: Watcher = lambda done, total: None
) -> CalibratedImages:
    """Calibrate a camera by images of a chessboard: files, and folders of them.

    Images of another size than most are left out by name, as they are of another camera, or cut or scaled. watch: told
    after each image how many of how many are done. Raises UsageError for an unknown lens model, or without an image.
    Raises InputError if the images do not determine a camera, and names each image that was not used and why.
    """
    if model not in LENS_MODELS:
        raise UsageError(
            f"--model: there is no lens model {model}. Choose {' or '.join(LENS_MODELS)}. {OTHER_LENSES}."
        )
    files = sorted(set(image_files(paths)), key=natural_key)
    if not files:
        raise UsageError("no images of a board are given. Give image files or a folder.")
    images = []
    for file in files:
        images.append(_look(file, board))
        watch(len(images), len(files))
    width, height = size = _common_size(images)
    for k, image in enumerate(images):
        if image.size not in (None, size):
            words = "{} x {} pixels, while most have ".format(*image.size or ())
            images[k] = replace(image, corners=None, why=f"{words}{width} x {height}")
    views = [image.corners for image in images if image.corners is not None]
    try:
        calibration = calibrate_boards(views, board, size, model)
    except CalibrationError as error:
        reasons = "".join(f"\n  {i.path}: {i.why}" for i in images if i.corners is None)
        raise InputError(f"{error}{reasons}") from error
    return CalibratedImages(board, model, tuple(images), calibration)


def _common_size(images: list[BoardImage]) -> tuple[int, int]:
    counts = Counter(image.size for image in images if image.size is not None)
    if not counts:
        raise InputError(
            f"{images[0].path}: none of the {len(images)} images of a board can be decoded. Give JPEG or PNG files."
        )
    size, count = counts.most_common(1)[0]
    if 2 * count <= sum(counts.values()):
        listed = "; ".join(
            f"{one[0]} x {one[1]}: {', '.join(i.path.name for i in images if i.size == one)}"
            for one in counts
        )
        raise InputError(
            f"the images have {len(counts)} sizes ({listed}), but a camera has one. Calibrate each camera separately."
        )
    return size


def _look(file: Path, board: Board) -> BoardImage:
    """An image with its corners, or in words why there are none; raises InputError for one that Exif turns."""
    try:
        data = read_input(file)
        decoded = cv2.imdecode(np.frombuffer(data, np.uint8), _AS_STORED) if data else None
    except OSError as error:
        return BoardImage(file, None, None, f"cannot be read: {error.strerror or error}")
    except cv2.error:
        decoded = None
    if decoded is None:
        return BoardImage(file, None, None, "no image that can be decoded")
    refuse_turned(str(file), read_exif(data))
    found = find_board(np.asarray(decoded, np.uint8), board)
    return BoardImage(file, (decoded.shape[1], decoded.shape[0]), found.corners, found.why)
