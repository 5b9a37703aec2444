"""Where in the image a board was seen, and how well its corners fit: as a picture, and in words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wayside.pipeline.calibration.boards import CalibratedImages
from wayside.schemas.frame import Camera
from wayside.stages.calibration import format_residuals
from wayside.stages.geometry import distort_points, ideal_points
from wayside.stages.kernels import Array

_CELLS = 16
"""Cells across the image."""
_WIDTH, _LEGEND, _DPI = 1200, 40, 100
_SHADES, _LINE, _UNUSED, _DOT = ("white", "#f0e2de"), "#bebebe", "#969696", 25
_LARGEST_GAP_PX = 0.5
_FAR = 0.8
_BORDER_POINTS = 41


class Coverage(NamedTuple):
    """Corners of the used views in each cell of the image (rows, columns), and how far out they reach.

    reach: distance of the outermost corner from the principal point, over that of the farthest corner of the image.
    """

    counts: NDArray[np.int64]
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
    column = np.clip((corners[:, 0] + 0.5) * _CELLS / camera.width, 0, _CELLS - 1).astype(np.int64)
    row = np.clip((corners[:, 1] + 0.5) * rows / camera.height, 0, rows - 1).astype(np.int64)
    counts = np.zeros((rows, _CELLS), np.int64)
    np.add.at(counts, (row, column), 1)
    centre = np.array([camera.cx, camera.cy])
    outermost = np.linalg.norm(corners - centre, axis=1).max()
    farthest = np.linalg.norm(_image_corners(camera) - centre, axis=1).max()
    return Coverage(counts, float(outermost / farthest))


def _image_corners(camera: Camera) -> Array:
    """Pixels (4, 2) in the corners of the image."""
    right, bottom = camera.width - 1.0, camera.height - 1.0
    return np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]])


def draw_coverage(found: CalibratedImages) -> NDArray[np.uint8]:
    """BGR picture: corners of all views on the image plane, coloured by residual, and cells without corners.

    Blue is a residual of zero, red one of three times the RMS or more; grey corners are of views left out. Cells
    without a corner of a used view are shaded.
    """
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
        f"residual 0 (blue) to {largest:.2f} px (red); "
        f"shaded: no corner ({100 * coverage.empty:.0f} %); outermost corner at "
        f"{100 * coverage.reach:.0f} % of the image's"
    )
    figure.text(0.01, 0.3 * _LEGEND / height, words)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    return np.ascontiguousarray(rgba[..., 2::-1])


def format_boards(found: CalibratedImages) -> str:
    """Every image with its residual or the reason why it was not used, the parameters, and what to beware of."""
    coverage = coverage_of(found)
    lines = [
        found.headline,
        f"corners in {100 * (1 - coverage.empty):.0f} % of the cells of the image, out to "
        f"{100 * coverage.reach:.0f} % of the distance of its corners",
        f"residuals by lens model: {format_residuals(found.calibration.by_model)}",
    ]
    if coverage.reach < _FAR:
        lines.append(
            "beware: the distortion farther out is extrapolated; photograph the board there"
        )
    if not _largest_gap(found.calibration.camera) < _LARGEST_GAP_PX:
        lines.append(
            "beware: near the border the distortion is not invertible, so points there have no direction; "
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
