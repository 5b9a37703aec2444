"""Three maps of one sign from above: on the whole drive, with its lines of sight, and its error ellipse.

World x goes right and y up, true to scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.canvas import (
    ACCENT,
    FAINT,
    MEDIUM,
    TEXT,
    Canvas,
)
from wayside.pipeline.evidence.gather import DriveMap, Evidence
from wayside.pipeline.evidence.marks import Ink, ink_of

OTHERS: Ink = (168, 175, 184)
SIGHT: Ink = (240, 170, 210)
ELLIPSE_FILL: Ink = (252, 226, 240)
SIGMAS = 2.0
_MARGIN_PX, _FOOT_PX = 26, 46
_SMALL, _DOT_PX, _OTHER_PX = 17, 8.5, 4.5
_NARROWEST_M = 20.0
_PANEL_THICKNESS, _ARROW_PX = 7, 11


@dataclass(frozen=True, slots=True)
class Projection:
    """World x, y (metres) to page: `scale` pixels a metre, `centre` metres shown at `middle` pixels."""

    scale: float
    centre: NDArray[np.float64]
    middle: NDArray[np.float64]

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Page points of world points (..., 2)."""
        page: NDArray[np.float64] = (points[..., :2] - self.centre) * [1, -1] * self.scale
        return page + self.middle


def fit(points: NDArray[np.float64], size: tuple[int, int], narrowest_m: float) -> Projection:
    """Projection that shows all points (n, 2) on a map of that size, and no less than `narrowest_m` metres."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    room = np.array(size, np.float64) - [2 * _MARGIN_PX, _MARGIN_PX + _FOOT_PX]
    scale = float(np.min(room / np.maximum(high - low, narrowest_m)))
    middle = np.array([size[0] / 2, _MARGIN_PX + room[1] / 2])
    return Projection(scale, (low + high) / 2, middle)


def draw_drive_map(page: Canvas, evidence: Evidence, drive: DriveMap) -> None:
    """The camera's path, every sign in grey and this one in its colour."""
    position = _position(evidence)
    everything = np.concatenate([drive.path[:, :2], drive.signs[:, :2]])
    to_page = fit(everything, _size(page), _NARROWEST_M)
    _draw_path(page, to_page, drive)
    _draw_others(page, to_page, drive, position)
    _draw_ellipse(page, to_page, evidence)
    _draw_sign(page, to_page, evidence)
    _draw_foot(page, to_page, drive.north)


def draw_sight_map(page: Canvas, evidence: Evidence, drive: DriveMap) -> None:
    """Where the camera stood when it measured the sign, with the lines of sight."""
    position = _position(evidence)
    stands = [drive.cameras[v.frame] for v in evidence.views if v.frame in drive.cameras]
    cameras = np.array(stands, np.float64).reshape(-1, 3)
    shown = np.concatenate([cameras[:, :2], position[None]])
    to_page = fit(shown, _size(page), _NARROWEST_M)
    for camera in cameras:
        page.line(to_page(np.stack([camera[:2], position])), SIGHT)
    _draw_path(page, to_page, drive)
    for camera in cameras:
        page.dot(to_page(camera), 5, TEXT)
    _draw_others(page, to_page, drive, position)
    _draw_ellipse(page, to_page, evidence)
    _draw_sign(page, to_page, evidence)
    _draw_foot(page, to_page, drive.north)


def draw_ellipse_map(page: Canvas, evidence: Evidence, drive: DriveMap) -> None:
    """The error ellipse close by, the panel as a line of its measured width, and the direction of travel."""
    ellipse, panel = error_ellipse(evidence), panel_line(evidence, drive)
    position = _position(evidence)
    shown = np.concatenate([position[None], ellipse, panel])
    to_page = fit(shown, _size(page), 0.5)
    _draw_ellipse(page, to_page, evidence)
    if len(panel):
        page.line(to_page(panel), TEXT, _PANEL_THICKNESS + 4)
        page.line(to_page(panel), ink_of(evidence.sign["color"]), _PANEL_THICKNESS)
    page.dot(to_page(position), 4, ACCENT)
    _draw_foot(page, to_page, drive.north)


def error_ellipse(evidence: Evidence) -> NDArray[np.float64]:
    """World outline (n, 2) of the 2-sigma ellipse of x and y; no points where the covariance is not known."""
    if evidence.sign["covariance"] is None:
        return np.zeros((0, 2))
    xx, xy, _, yy, _, _ = evidence.sign["covariance"]
    spread, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]], np.float64))
    angle = np.linspace(0, 2 * np.pi, 73)[:-1]
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outline: NDArray[np.float64] = (SIGMAS * circle * np.sqrt(np.maximum(spread, 0))) @ axes.T
    return outline + _position(evidence)


def panel_line(evidence: Evidence, drive: DriveMap) -> NDArray[np.float64]:
    """Ends (2, 2) of the panel seen from above; no points where its width or the direction of travel is not known."""
    width, facing = evidence.sign["panel_width_m"], evidence.sign["facing_deg"]
    travel = _travel_at(evidence, drive)
    if width is None or travel is None:
        return np.zeros((0, 2))
    angle = math.radians(facing or 0.0)
    across = np.array([-travel[1], travel[0]])  # the line of a panel that faces the camera
    rotation = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    half = rotation @ across * width / 2
    return np.stack([_position(evidence) - half, _position(evidence) + half])


def _travel_at(evidence: Evidence, drive: DriveMap) -> NDArray[np.float64] | None:
    """Unit direction (2,) of the path where it passes nearest to the sign."""
    path = drive.path[:, :2]
    if len(path) < 2:
        return None
    nearest = int(np.argmin(np.linalg.norm(path - _position(evidence), axis=1)))
    step = path[min(nearest + 1, len(path) - 1)] - path[max(nearest - 1, 0)]
    length = float(np.linalg.norm(step))
    return step / length if length > 0 else None


def _position(evidence: Evidence) -> NDArray[np.float64]:
    return np.array([evidence.sign["x"], evidence.sign["y"]], np.float64)


def _size(page: Canvas) -> tuple[int, int]:
    return page.rgb.shape[1], page.rgb.shape[0]


def _draw_path(page: Canvas, to_page: Projection, drive: DriveMap) -> None:
    page.line(to_page(drive.path), FAINT, 2)


def _draw_others(
    page: Canvas, to_page: Projection, drive: DriveMap, position: NDArray[np.float64]
) -> None:
    for other in to_page(drive.signs[np.any(drive.signs[:, :2] != position, axis=1)]):
        page.dot(other, _OTHER_PX, OTHERS)


def _draw_ellipse(page: Canvas, to_page: Projection, evidence: Evidence) -> None:
    outline = error_ellipse(evidence)
    if len(outline):
        page.polygon(to_page(outline), ELLIPSE_FILL, ACCENT, 2)


def _draw_sign(page: Canvas, to_page: Projection, evidence: Evidence) -> None:
    page.dot(to_page(_position(evidence)), _DOT_PX, ink_of(evidence.sign["color"]), TEXT)


def _draw_foot(page: Canvas, to_page: Projection, north: NDArray[np.float64] | None) -> None:
    """Scale bar at the left, at the right an arrow to the north or what the axes are, below the map."""
    width, height = _size(page)
    length_m = round_length(0.3 * width / to_page.scale)
    baseline, left = height - 17, _MARGIN_PX
    right = left + length_m * to_page.scale
    tick = 5
    page.line(
        [
            (left, baseline - 5 - tick),
            (left, baseline - 5),
            (right, baseline - 5),
            (right, baseline - 5 - tick),
        ],
        TEXT,
        2,
    )
    page.text((right + 10, baseline), length_words(length_m), _SMALL, TEXT, MEDIUM)
    words, end = "x right, y up", width - _MARGIN_PX
    if north is not None:
        words, end = "north", end - 2 * _ARROW_PX - 6
        _draw_arrow(page, np.array([width - _MARGIN_PX - _ARROW_PX, baseline - 6]), north)
    page.text((end, baseline), words, _SMALL, FAINT, right=True)


def _draw_arrow(page: Canvas, middle: NDArray[np.float64], towards: NDArray[np.float64]) -> None:
    """An arrow about a point of the page, in a direction (2,) of the world."""
    along = towards * [1, -1] * _ARROW_PX
    across = np.array([-along[1], along[0]])
    tip = middle + along
    page.line([middle - along, tip], TEXT, 2)
    page.line([tip - (along - across) / 2, tip, tip - (along + across) / 2], TEXT, 2)


def round_length(most: float) -> float:
    """The longest length of 1, 2 or 5 times a power of ten that is not above `most`."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in (1, 2, 5) if step * power <= most)


def length_words(metres: float) -> str:
    """A length as a scale bar says it."""
    if metres >= 1000:
        return f"{metres / 1000:g} km"
    return f"{metres:g} m" if metres >= 1 else f"{metres * 100:g} cm"
