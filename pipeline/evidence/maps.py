"""Three maps of one sign from above: on the whole drive, with its lines of sight, and its error ellipse.

World x goes right and y up, true to scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.gather import DriveMap, Evidence

Points = NDArray[np.float64]
SIGMAS = 2.0
MARGIN_PX, FOOT_PX = 26, 46
"""Around a map, and for the scale bar below it."""
MAP_SIZE = 484, 340
_NARROWEST_M, _NARROWEST_CLOSE_M = 20.0, 0.5


@dataclass(frozen=True, slots=True)
class Projection:
    """World x, y (metres) to page, x right and y down."""

    scale: float
    """Pixels a metre."""
    centre: Points
    """Turned metres (2,) shown at `middle`."""
    middle: Points
    """Pixels (2,)."""
    extent: Points
    """Pixels (2,) of what is shown, `middle` in its middle."""
    turn: Points = field(default_factory=lambda: np.eye(2))
    """Turns rows x, y, (2, 2)."""

    def __call__(self, points: Points) -> Points:
        """Page points of world points (..., 2), to a tenth of a pixel."""
        page = (points[..., :2] @ self.turn - self.centre) * [1, -1] * self.scale
        return np.round(page + self.middle, 1)

    def foot(
        self, box: tuple[float, float, float, float], north: Points | None, axes: str = ""
    ) -> dict[str, Any]:
        """Scale bar and, where it is known, an arrow to the north or what the axes are, at the foot of a map.

        box: left, top, width and height of the map, pixels.
        """
        left, top, width, height = box
        most = 0.3 * width / self.scale
        power = 10.0 ** math.floor(math.log10(most))
        metres = max(step * power for step in (1, 2, 5) if step * power <= most)
        words = f"{metres * 100:g} cm" if metres < 1 else f"{metres:g} m"
        x, y = (0, 1) if north is None else north @ self.turn
        return {
            "left": round(left + MARGIN_PX, 1),
            "bar": round(left + MARGIN_PX + metres * self.scale, 1),
            "right": round(left + width - MARGIN_PX, 1),
            "base": round(top + height - 17, 1),
            "words": f"{metres / 1000:g} km" if metres >= 1000 else words,
            "axes": axes,
            "turn_deg": None if north is None else round(math.degrees(math.atan2(x, y)), 1),
        }


def fit(
    points: Points, size: tuple[int, int], narrowest_m: float, turn: Points | None = None
) -> Projection:
    """Projection that shows all points (n, 2) on a map of that size, and no less than `narrowest_m` metres."""
    turn = np.eye(2) if turn is None else turn
    turned = points[:, :2] @ turn
    low, high = turned.min(axis=0), turned.max(axis=0)
    room = np.array(size, np.float64) - [2 * MARGIN_PX, MARGIN_PX + FOOT_PX]
    extent = np.maximum(high - low, narrowest_m)
    scale = float(np.min(room / extent))
    middle = np.array([size[0] / 2, MARGIN_PX + room[1] / 2])
    return Projection(scale, (low + high) / 2, middle, extent * scale, turn)


def sign_maps(evidence: Evidence, drive: DriveMap) -> list[dict[str, Any]]:
    """Maps as the macro `drawing` of `drawings.svg` takes them: shapes in pixels by name.

    On the first two the camera's path, every sign in grey and this one in its colour, on the second also where the
    camera stood when it measured the sign. On the third the error ellipse close by, and the panel as a line of its
    measured width.
    """
    position, path, signs = _position(evidence), drive.path[:, :2], drive.signs[:, :2]
    ellipse, panel = error_ellipse(evidence), panel_line(evidence, drive)
    stands = [drive.cameras[v.frame] for v in evidence.views if v.frame in drive.cameras]
    cameras = np.array(stands, np.float64).reshape(-1, 3)[:, :2]
    others = signs[np.any(signs != position, axis=1)]
    road = {"path": path, "others": others, "ellipse": ellipse, "sign": position[None]}
    close = {"ellipse": ellipse, "panel": panel, "centre": position[None]}
    none = dict.fromkeys(("path", "others", "sign", "cameras", "panel", "centre"), np.zeros((0, 2)))
    maps = []
    for heading, shown, narrowest_m, shapes in (
        ("Whole drive", [path, signs], _NARROWEST_M, road),
        ("Lines of sight", [cameras, position[None]], _NARROWEST_M, road | {"cameras": cameras}),
        ("2-sigma error ellipse and panel", [*close.values()], _NARROWEST_CLOSE_M, close),
    ):
        to_page = fit(np.concatenate(shown), MAP_SIZE, narrowest_m)
        foot = to_page.foot((0, 0, *MAP_SIZE), drive.north, "x right, y up")
        drawn = {name: to_page(points).tolist() for name, points in (none | shapes).items()}
        maps.append(
            {"heading": heading, "width": MAP_SIZE[0], "height": MAP_SIZE[1], "foot": foot} | drawn
        )
    return maps


def error_ellipse(evidence: Evidence) -> Points:
    """World outline (n, 2) of the 2-sigma ellipse of x and y; no points where the covariance is not known."""
    if evidence.sign["covariance"] is None:
        return np.zeros((0, 2))
    xx, xy, _, yy, _, _ = evidence.sign["covariance"]
    spread, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]], np.float64))
    angle = np.linspace(0, 2 * np.pi, 73)[:-1]
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outline: Points = (SIGMAS * circle * np.sqrt(np.maximum(spread, 0))) @ axes.T
    return outline + _position(evidence)


def panel_line(evidence: Evidence, drive: DriveMap) -> Points:
    """Ends (2, 2) of the panel seen from above; no points where its width or the direction of travel is not known."""
    width, path, position = evidence.sign["panel_width_m"], drive.path[:, :2], _position(evidence)
    if width is None or len(path) < 2:
        return np.zeros((0, 2))
    nearest = int(np.argmin(np.linalg.norm(path - position, axis=1)))
    x, y = path[min(nearest + 1, len(path) - 1)] - path[max(nearest - 1, 0)]
    length = math.hypot(x, y)
    if length == 0:
        return np.zeros((0, 2))
    across = np.array([-y, x]) / length  # the line of a panel that faces the camera
    angle = math.radians(evidence.sign["facing_deg"] or 0.0)
    rotation = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    half = rotation @ across * width / 2
    return np.stack([position - half, position + half])


def _position(evidence: Evidence) -> Points:
    return np.array([evidence.sign["x"], evidence.sign["y"]], np.float64)
