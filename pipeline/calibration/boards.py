"""Images of a chessboard to a camera: which images are used, and which not and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

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

Size = tuple[int, int]
Watcher = Callable[[int, int], None]

_AS_STORED = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
"""Images that Exif turns are refused before this makes a difference."""


@dataclass(frozen=True, slots=True)
class BoardImage:
    """An image given: corners (n, 2) or None, and why it has none."""

    path: Path
    corners: Array | None
    why: str = ""


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
    """Calibrate a camera by images of a chessboard.

    Images of another size than most are refused by name, as they are of another camera, or cut or scaled.

    Parameters
    ----------
    paths
        Image files, and folders of them.
    board, model
        The board, a lens model and what decides about views.
    watch
        Told after each image how many of how many are done.

    Raises
    ------
    UsageError
        An unknown lens model, or no image among the paths.
    InputError
        The images do not determine a camera (the message names each image that was not used and why), or one is to
        be shown otherwise than it is stored.
    """
    if model not in LENS_MODELS:
        raise UsageError(
            f"--model: there is no lens model {model}. Choose {' or '.join(LENS_MODELS)}. {OTHER_LENSES}."
        )
    files = sorted(set(image_files(paths)), key=natural_key)
    if not files:
        raise UsageError("no images of a board are given. Give image files or a folder.")
    decoded = [_size_of(file) for file in files]
    wanted = _common_size(files, decoded)
    images = []
    for file, size in zip(files, decoded, strict=True):
        images.append(_look(file, size, wanted, board))
        watch(len(images), len(files))
    views = [image.corners for image in images if image.corners is not None]
    try:
        calibration = calibrate_boards(views, board, wanted, model)
    except CalibrationError as error:
        reasons = "".join(f"\n  {i.path}: {i.why}" for i in images if i.corners is None)
        raise InputError(f"{error}{reasons}") from error
    return CalibratedImages(board, model, tuple(images), calibration)


def _common_size(files: list[Path], sizes: list[Size | str]) -> Size:
    counts = Counter(size for size in sizes if not isinstance(size, str))
    if not counts:
        raise InputError(
            f"{files[0]}: none of the {len(files)} images of a board can be decoded. Give JPEG or PNG files."
        )
    size, count = counts.most_common(1)[0]
    if 2 * count <= sum(counts.values()):
        listed = "; ".join(
            f"{w} x {h}: {', '.join(f.name for f, s in zip(files, sizes, strict=True) if s == (w, h))}"
            for w, h in counts
        )
        raise InputError(
            f"the images have {len(counts)} sizes ({listed}), but a camera has one. Calibrate each camera separately."
        )
    return size


def _size_of(file: Path) -> Size | str:
    grey = _read(file)
    return grey if isinstance(grey, str) else (grey.shape[1], grey.shape[0])


def _look(file: Path, size: Size | str, wanted: Size, board: Board) -> BoardImage:
    if isinstance(size, str):
        return BoardImage(file, None, size)
    if size != wanted:
        words = f"{size[0]} x {size[1]} pixels, while most have {wanted[0]} x {wanted[1]}"
        return BoardImage(file, None, words)
    grey = _read(file)
    if isinstance(grey, str) or (grey.shape[1], grey.shape[0]) != size:
        raise InputError(
            f"{file}: the image has changed since it was first read. Leave the images alone during calibration."
        )
    found = find_board(grey, board)
    return BoardImage(file, found.corners, found.why)


def _read(file: Path) -> NDArray[np.uint8] | str:
    """Grey values of an image, or in words why there are none; raises InputError for one that Exif turns."""
    try:
        data = read_input(file)
        decoded = cv2.imdecode(np.frombuffer(data, np.uint8), _AS_STORED) if data else None
    except OSError as error:
        return f"cannot be read: {error.strerror or error}"
    except cv2.error:
        decoded = None
    if decoded is None:
        return "no image that can be decoded"
    refuse_turned(str(file), read_exif(data))
    return np.asarray(decoded, np.uint8)
