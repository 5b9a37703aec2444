"""A camera from images of a chessboard: which images are used, and why not, and the result as picture and text."""

from collections import Counter
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from wayside.pipeline.files.input_files import read_input
from wayside.pipeline.reading.calibrations import OTHER_LENSES
from wayside.pipeline.reading.image_headers import read_exif, refuse_turned
from wayside.pipeline.reading.image_order import image_files, natural_key
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Camera
from wayside.stages.calibration import (
    LENS_MODELS,
    Board,
    BoardCalibration,
    CalibrationError,
    FittedView,
    calibrate_boards,
    find_board,
    format_residuals,
)
from wayside.stages.geometry import distort_points, ideal_points
from wayside.stages.kernels import Array, Bytes, Numbers

_AS_STORED = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
"""Images that Exif turns are refused before this makes a difference."""
_CELLS = 16
"""Cells across the image."""
_WIDTH, _LEGEND, _DPI = 1200, 90, 100
_SHADES, _LINE, _UNUSED, _DOT = ("white", "#f0e2de"), "#bebebe", "#969696", 25
_LARGEST_GAP_PX = 0.5
_FAR = 0.8
_BORDER_POINTS = 41


class BoardImage(NamedTuple):
    """An image given: width and height (None: it cannot be decoded), corners (n, 2), or `why` it has none."""

    path: Path
    size: tuple[int, int] | None
    corners: Array | None
    why: str = ""


@dataclass(frozen=True, slots=True)
class CalibratedImages:
    """A calibration with all given images, in natural order of their names; only those with corners are views."""

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
            f"--board: {text!r} does not give the inner corners. Give how many there are along both sides, at least 3: "
            "a board of 10 x 7 squares is 9x6."
        )
    return Board(int(columns), int(rows), square_m)


def calibrate_images(paths: list[Path], board: Board, model: str) -> CalibratedImages:
    """Calibrate a camera by images of a chessboard: files, and folders of them.

    Images of another size than most are left out by name: another camera took them, or they were cut or scaled.
    Raises UsageError for an unknown lens model, or without an image. Raises InputError if the images do not determine a
    camera, with the reason for each unused image.
    """
    if model not in LENS_MODELS:
        raise UsageError(
            f"--model: there is no lens model {model}. Choose {' or '.join(LENS_MODELS)}. {OTHER_LENSES}."
        )
    files = sorted(set(image_files(paths)), key=natural_key)
    if not files:
        raise UsageError("no images of a board are given. Give image files or a folder.")
    images = [_look(file, board) for file in files]
    width, height = size = _common_size(images)
    for k, image in enumerate(images):
        if image.size not in (None, size):
            words = "{} x {} pixels, while most have ".format(*image.size or ())
            images[k] = image._replace(corners=None, why=f"{words}{width} x {height}")
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


class Coverage(NamedTuple):
    """Corners of the used views in each cell of the image (rows, columns), and how far out they reach.

    `reach`: distance of the outermost corner from the principal point, over that of the farthest corner of the image.
    """

    counts: Numbers
    reach: float

    @property
    def empty(self) -> float:
        """Fraction of cells without a corner."""
        return float((self.counts == 0).mean())


def coverage_of(found: CalibratedImages) -> Coverage:
    """Count the corners of the used views in nearly square cells."""
    camera = found.calibration.camera
    rows = max(1, round(_CELLS * camera.height / camera.width))
    corners = _corners(found, used=True)
    sides = (-0.5, camera.height - 0.5), (-0.5, camera.width - 0.5)
    counts, _, _ = np.histogram2d(corners[:, 1], corners[:, 0], (rows, _CELLS), sides)
    centre = np.array([camera.cx, camera.cy])
    outermost = np.linalg.norm(corners - centre, axis=1).max()
    farthest = np.linalg.norm(_image_corners(camera) - centre, axis=1).max()
    return Coverage(counts.astype(np.int64), float(outermost / farthest))


def _image_corners(camera: Camera) -> Array:
    """Pixels (4, 2) in the corners of the image."""
    right, bottom = camera.width - 1.0, camera.height - 1.0
    return np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]])


def draw_coverage(found: CalibratedImages) -> Bytes:
    """BGR picture: corners of all views on the image plane, coloured by residual, and cells without corners.

    Blue is a residual of zero, red one of three times the RMS or more; grey corners are of views left out. Cells
    without a corner of a used view are shaded.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # here, as a run draws nothing
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

    camera, coverage = found.calibration.camera, coverage_of(found)
    largest = 3 * max(found.calibration.rms_px, 1e-9)
    residuals = np.concatenate([view.residuals for _, view in found.seen if view.used])
    height = _WIDTH * camera.height / camera.width + _LEGEND
    figure = Figure((_WIDTH / _DPI, height / _DPI), dpi=_DPI)
    axes = figure.add_axes((0, _LEGEND / height, 1, 1 - _LEGEND / height))
    rows = len(coverage.counts)
    x, y = np.linspace(0, camera.width, _CELLS + 1), np.linspace(0, camera.height, rows + 1)
    shades = ListedColormap(_SHADES)
    axes.pcolormesh(x, y, coverage.counts == 0, cmap=shades, vmin=0, vmax=1, edgecolors=_LINE, lw=1)
    lengths = np.linalg.norm(residuals, axis=1)
    left_out, fitted = _corners(found, used=False), _corners(found, used=True)
    axes.scatter(left_out[:, 0], left_out[:, 1], _DOT, _UNUSED)
    axes.scatter(fitted[:, 0], fitted[:, 1], _DOT, lengths, cmap="jet", vmin=0, vmax=largest)
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0))
    axes.set_axis_off()
    words = (
        f"{len(lengths)} corners of {sum(v.used for v in found.calibration.views)} views, "
        f"residual 0 (blue) to {largest:.2f} px (red)\nshaded: no corner ({100 * coverage.empty:.0f} %); "
        f"outermost corner at {100 * coverage.reach:.0f} % of the image's"
    )
    figure.text(0.01, 0.2 * _LEGEND / height, words, fontsize=22)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    return np.ascontiguousarray(rgba[..., 2::-1])


def format_boards(found: CalibratedImages) -> str:
    """Every image with its residual or the reason why it was not used, the parameters, and warnings."""
    coverage = coverage_of(found)
    lines = [
        found.headline,
        f"corners in {100 * (1 - coverage.empty):.0f} % of the cells of the image, out to "
        f"{100 * coverage.reach:.0f} % of the distance of its corners",
        f"residuals by lens model: {format_residuals(found.calibration.by_model)}",
    ]
    if coverage.reach < _FAR:
        lines.append(
            "warning: the distortion farther out is extrapolated; photograph the board there"
        )
    if not _largest_gap(found.calibration.camera) < _LARGEST_GAP_PX:
        lines.append(
            "warning: near the border the distortion is not invertible, so points there have no direction; "
            "photograph the board there, or use a simpler --model"
        )
    return "\n".join([*found.image_lines(), "", *found.parameter_lines(), "", *lines])


def _largest_gap(camera: Camera) -> float:
    """Largest distance, px, between points of the border and themselves after undistortion and distortion."""
    corners = _image_corners(camera)
    steps = np.linspace(0.0, 1.0, _BORDER_POINTS)[:, None]
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    border = np.concatenate([a + steps * (b - a) for a, b in sides])
    back = distort_points(camera, ideal_points(camera, border))
    return float(np.linalg.norm(back - border, axis=1).max())


def _corners(found: CalibratedImages, *, used: bool) -> Array:
    kept = [
        image.corners
        for image, view in found.seen
        if view.used is used and image.corners is not None
    ]
    return np.concatenate([np.zeros((0, 2)), *kept])
