"""Where in the image a board was seen, and how well its corners fit: as a picture, and in words."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.calibration.boards import CalibratedImages
from wayside.schemas.frame import Camera
from wayside.stages.calibration import format_residuals
from wayside.stages.geometry import distort_points, ideal_points
from wayside.stages.kernels import Array

_CELLS = 16
"""Cells across the image."""
_WIDTH, _LEGEND = 1200, 40
_GROUND, _EMPTY, _LINE, _INK = (255, 255, 255), (222, 226, 240), (190, 190, 190), (40, 40, 40)
_UNUSED = (150, 150, 150)
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
    camera, rms = found.calibration.camera, found.calibration.rms_px
    scale = _WIDTH / camera.width
    height = round(camera.height * scale)
    picture = np.full((height + _LEGEND, _WIDTH, 3), _GROUND, np.uint8)
    coverage = coverage_of(found)
    rows = len(coverage.counts)
    for row, column in np.ndindex(rows, _CELLS):
        x0, x1 = _WIDTH * column // _CELLS, _WIDTH * (column + 1) // _CELLS
        y0, y1 = height * row // rows, height * (row + 1) // rows
        if coverage.counts[row, column] == 0:
            cv2.rectangle(picture, (x0, y0), (x1 - 1, y1 - 1), _EMPTY, cv2.FILLED)
        cv2.rectangle(picture, (x0, y0), (x1, y1), _LINE, 1)
    for place in _corners(found, used=False):
        _dot(picture, place * scale, _UNUSED)
    largest = 3 * max(rms, 1e-9)
    residuals = np.concatenate([view.residuals for _, view in found.seen if view.used])
    lengths = np.linalg.norm(residuals, axis=1)
    colors = _colors(lengths / largest)
    for place, color in zip(_corners(found, used=True), colors, strict=True):
        _dot(picture, place * scale, tuple(map(int, color)))
    words = (
        f"{len(lengths)} corners of {sum(v.used for v in found.calibration.views)} views, "
        f"residual 0 (blue) to {largest:.2f} px (red); "
        f"shaded: no corner ({100 * coverage.empty:.0f} %); outermost corner at "
        f"{100 * coverage.reach:.0f} % of the image's"
    )
    origin = (10, height + _LEGEND - 14)
    cv2.putText(picture, words, origin, cv2.FONT_HERSHEY_SIMPLEX, 0.55, _INK, 1, cv2.LINE_AA)
    return picture


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


def _colors(fractions: Array) -> NDArray[np.uint8]:
    levels = np.clip(255 * fractions, 0, 255).astype(np.uint8)
    mapped = cv2.applyColorMap(levels.reshape(-1, 1), cv2.COLORMAP_JET)
    return np.asarray(mapped, np.uint8).reshape(-1, 3)


def _dot(picture: NDArray[np.uint8], place: Array, color: tuple[int, ...]) -> None:
    x, y = np.rint(place).astype(int)
    cv2.circle(picture, (int(x), int(y)), 4, color, cv2.FILLED, cv2.LINE_AA)
