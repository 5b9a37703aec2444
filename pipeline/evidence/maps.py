"""Maps from above: of a whole drive; of one sign on it, with its lines of sight, and its error ellipse.

North is up where it is known, else world y; true to scale.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.gather import DriveMap, Evidence
from wayside.pipeline.evidence.marks import METRIC, Units

Points = NDArray[np.float64]
SIGMAS = 2.0
MARGIN_PX, FOOT_PX = 26, 46
"""Around a map, and for the scale bar below it."""
MAP_SIZE = 484, 340
_OVERVIEW, _OVERVIEW_POINTS = (1200, 400), 1000
_NARROWEST_M, _NARROWEST_CLOSE_M = 20.0, 0.5


class Projection:
    """World x, y (metres) to page, x right and y down.

    It shows all points (n, 2) on a map of a size in pixels, and no less than `narrowest_m` metres. `turn`: matrix
    (2, 2) that turns rows x, y first, so that north is up; None: north is not known.
    """

    def __init__(
        self, points: Points, size: tuple[int, int], narrowest_m: float, turn: Points | None = None
    ) -> None:
        self.turn: Points = np.eye(2) if turn is None else turn
        self.north = turn is not None
        turned = points[:, :2] @ self.turn
        low, high = turned.min(axis=0), turned.max(axis=0)
        room = np.array(size, np.float64) - [2 * MARGIN_PX, MARGIN_PX + FOOT_PX]
        extent = np.maximum(high - low, narrowest_m)
        self.scale = float(np.min(room / extent))
        """Pixels a metre."""
        self.centre: Points = (low + high) / 2
        """Turned metres (2,) shown at `middle`, pixels (2,)."""
        self.middle: Points = np.array([size[0] / 2, MARGIN_PX + room[1] / 2])
        self.extent: Points = extent * self.scale
        """Pixels (2,) of what is shown, `middle` in its middle."""

    def __call__(self, points: Points) -> Points:
        """Page points of world points (..., 2), to a tenth of a pixel."""
        page: Points = (points[..., :2] @ self.turn - self.centre) * [1, -1] * self.scale
        return np.round(page + self.middle, 1)

    def foot(self, box: tuple[float, float, float, float], units: Units) -> dict[str, Any]:
        """Scale bar and, where it is up, an arrow to the north, else what the axes are, at the foot of a map.

        `box`: left, top, width and height of the map, pixels.
        """
        left, top, width, height = box
        most = 0.3 * width / self.scale / units.metres
        power = 10.0 ** math.floor(math.log10(most))
        length = max(step * power for step in (1, 2, 5) if step * power <= most)
        return {
            "left": round(left + MARGIN_PX, 1),
            "bar": round(left + MARGIN_PX + length * units.metres * self.scale, 1),
            "right": round(left + width - MARGIN_PX, 1),
            "base": round(top + height - 17, 1),
            "words": f"{length:g} {units.long}",
            "north": self.north,
        }


def overview(
    drive: DriveMap, units: Units = METRIC
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """The path and every sign, in pixels, as the macro `overview` of `drawings.svg` takes them; None without any.

    Also what `map.js` needs: `turn`, `scale`, the page's origin in turned metres (`left`, `top`), and `unit`, metres.
    On the globe also the degrees of the origin and of a pixel.
    """
    path, globe = drive.path[:, :2], drive.globe
    points = np.concatenate([path, drive.signs[:, :2]])
    if not len(points):
        return None
    to_map = Projection(points, _OVERVIEW, 1.0, None if globe is None else globe.turn)
    left, top = to_map.middle - to_map.extent / 2 - MARGIN_PX
    width, height = to_map.extent + np.array([2 * MARGIN_PX, MARGIN_PX + FOOT_PX])
    box = left, top, width, height
    thinned = path[:: max(1, len(path) // _OVERVIEW_POINTS)]
    shown = {
        "box": [round(float(edge)) for edge in box],
        "path": to_map(np.concatenate([thinned, path[-1:]])).tolist(),
        "signs": to_map(drive.signs).tolist(),
        "foot": to_map.foot(box, units),
    }
    x, y = (to_map.centre + to_map.middle * [-1, 1] / to_map.scale).tolist()
    about = {"turn": to_map.turn.tolist(), "scale": to_map.scale, "left": x, "top": y}
    about |= {"unit": units.metres, "units": units.long}
    if globe is not None:
        steps = globe.lon_deg_per_m, globe.lat_deg_per_m
        about["lon"], about["lat"] = globe.lon_deg + x * steps[0], globe.lat_deg + y * steps[1]
        about["steps"] = [step / to_map.scale for step in steps]
    return shown, about


def sign_maps(evidence: Evidence, drive: DriveMap, units: Units = METRIC) -> list[dict[str, Any]]:
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
    turn, maps = None if drive.globe is None else drive.globe.turn, []
    for heading, shown, narrowest_m, shapes in (
        ("Whole drive", [path, signs], _NARROWEST_M, road),
        ("Lines of sight", [cameras, position[None]], _NARROWEST_M, road | {"cameras": cameras}),
        ("2-sigma error ellipse and panel", [*close.values()], _NARROWEST_CLOSE_M, close),
    ):
        to_page = Projection(np.concatenate(shown), MAP_SIZE, narrowest_m, turn)
        foot = to_page.foot((0, 0, *MAP_SIZE), units)
        drawn = {name: to_page(points).tolist() for name, points in (none | shapes).items()}
        about = {"heading": heading, "width": MAP_SIZE[0], "height": MAP_SIZE[1], "foot": foot}
        maps.append(about | drawn)
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
