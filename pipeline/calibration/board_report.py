"""A calibration by boards in words: for the terminal and for the head of the camera file."""

from __future__ import annotations

from math import isfinite

import numpy as np

from wayside.pipeline.calibration.boards import CalibratedImages
from wayside.pipeline.calibration.coverage import Coverage, image_corners
from wayside.schemas.frame import Camera
from wayside.stages.calibration import format_residuals
from wayside.stages.geometry import distort_points, ideal_points

_LARGEST_GAP_PX = 0.5
_FAR = 0.8
_BORDER_POINTS = 41


def format_boards(found: CalibratedImages, coverage: Coverage) -> str:
    """Every image with its residual or the reason why it was not used, the parameters, and what to beware of."""
    return "\n".join(
        [*_image_lines(found), "", *parameter_lines(found), "", *_closing(found, coverage)]
    )


def parameter_lines(found: CalibratedImages) -> list[str]:
    """Each parameter with both standard errors."""
    lines = [f"{'parameter':<10}{'value':>14}{'standard error':>18}{'by views':>14}"]
    for one in found.calibration.parameters:
        spread = f"{one.spread:14.4g}" if isfinite(one.spread) else f"{'-':>14}"
        lines.append(f"{one.name:<10}{one.value:14.6g}{one.sigma:18.4g}{spread}")
    return lines


def headline(found: CalibratedImages) -> str:
    """Images used, board, lens model and residual, in a line."""
    calibration = found.calibration
    used = sum(view.used for view in calibration.views)
    return (
        f"{used} of {len(found.images)} images, board of {found.board.columns} x {found.board.rows} "
        f"inner corners, {found.model}, residual {calibration.rms_px:.3f} px RMS"
    )


def _image_lines(found: CalibratedImages) -> list[str]:
    square_m = found.board.square_m
    unit = "m" if isfinite(square_m) else "squares"
    width = max(5, *(len(image.path.name) for image in found.images)) + 2
    lines = [f"{'image':<{width}}{'residual px':>11}{'tilt deg':>10}{'distance ' + unit:>18}"]
    for image, view in found.seen:
        distance = view.distance_squares * (square_m if isfinite(square_m) else 1.0)
        left_out = "" if view.used else "  left out: its residual is far above that of the others"
        lines.append(
            f"{image.path.name:<{width}}{view.rms_px:11.3f}{view.tilt_deg:10.0f}{distance:18.2f}{left_out}"
        )
    lines += [f"{image.path.name:<{width}}not used: {image.why}" for image in found.failed]
    return lines


def _closing(found: CalibratedImages, coverage: Coverage) -> list[str]:
    lines = [
        headline(found),
        f"corners in {100 * (1 - coverage.empty):.0f} % of the cells of the image, out to "
        f"{100 * coverage.reach:.0f} % of the distance of its corners",
        f"residuals by lens model: {format_residuals(found.calibration.by_model)}",
    ]
    if coverage.reach < _FAR:
        lines.append(
            "beware: the distortion farther out is extrapolated; photograph the board there"
        )
    gap_px = _largest_gap(found.calibration.camera)
    if not gap_px < _LARGEST_GAP_PX:
        lines.append(
            "beware: near the border the distortion is not invertible, so points there have no direction; "
            "photograph the board there, or use a simpler --model"
        )
    return lines


def _largest_gap(camera: Camera) -> float:
    """Largest distance, px, between points of the border and themselves after undistortion and distortion."""
    corners = image_corners(camera)
    steps = np.linspace(0.0, 1.0, _BORDER_POINTS)[:, None]
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    border = np.concatenate([a + steps * (b - a) for a, b in sides])
    back = distort_points(camera, ideal_points(camera, border))
    return float(np.linalg.norm(back - border, axis=1).max())
