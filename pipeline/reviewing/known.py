"""What a review can be of: the rows of a result, and places that are found again in another result of the drive."""

import heapq
import math
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.pipeline.results.result import read_rows, read_run, result_name
from wayside.pipeline.results.routes import with_route
from wayside.pipeline.reviewing.entries import ACCEPTED, LOOK, Reviewed
from wayside.schemas.frame import EARTH_RADIUS_M
from wayside.schemas.routes import MEASURE_UNITS
from wayside.schemas.settings import RouteSettings
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

_FRAME_COLUMNS = (
    *("frame", "log_time_ns", "image_name", "x", "y", "qx", "qy", "qz", "qw"),
    *("station_m", "lon_deg", "lat_deg", "heading_deg"),
)
_IMAGES = 4
"""That keep a place: another run may leave some out."""
_MEASURE_COLUMNS = ("station_m", "route", "measure", "measure_unit")
_SIGN_COLUMNS = ("sign_id", "x", "y", "mutcd", "vienna", *LOOK[1:], *_MEASURE_COLUMNS)


@dataclass(frozen=True, slots=True)
class KnownResult:
    """A result as reviews know it."""

    name: str
    """Its `result_name`."""
    rows: dict[str, Reviewed]
    """What the acceptance of each sign says, by `sign_id`."""
    cameras: Mapping[str, Mapping[str, Any]]
    """See `_camera`; by what names an image in every result: its file, or its log time."""
    measured: tuple[Mapping[str, Any], ...]
    """Where route and measure are known: at the start of a drive with a milepost, else abreast of the signs."""
    sense: float
    """1: measures rise in the direction of travel, -1: they fall."""

    @classmethod
    def of(cls, out: Path, route: RouteSettings | None = None) -> "KnownResult":
        """The result in a folder; raises InputError if it is missing or damaged.

        `route`: instead of that of the run.
        """
        run, signs = read_run(out), read_rows(out, SIGNS, _SIGN_COLUMNS)
        frames = read_rows(out, FRAMES, _FRAME_COLUMNS)
        names = Counter(row["image_name"] for row in frames)  # folders may number alike
        images = {
            row["frame"]: (names[row["image_name"]] == 1 and row["image_name"])
            or str(row["log_time_ns"])
            for row in frames
        }
        views: defaultdict[str, list[Any]] = defaultdict(list)
        for row in read_rows(out, OBSERVATIONS, ("sign_id", "frame", "box"), {"verdict": "sign"}):
            box = tuple(round(edge, 1) for edge in row["box"])
            views[row["sign_id"]].append((images.get(row["frame"], ""), box))
        cameras = {images[row["frame"]]: _camera(row) for row in frames if row["x"] is not None}
        along = [one for one in with_route(out, signs, route) if one["measure"] is not None]
        measured = sorted(along, key=_station)
        falls = bool(measured) and measured[-1]["measure"] < measured[0]["measure"]
        given = asdict(route) if route else (run.get("settings") or {}).get("route", {})
        if given.get("milepost", -1.0) >= 0:
            falls, start = given["decreasing"], (0.0, given["name"] or None, given["milepost"])
            measured = [dict(zip(_MEASURE_COLUMNS, (*start, given["unit"]), strict=True))]
        found = cls(result_name(run), {}, cameras, tuple(measured), -1.0 if falls else 1.0)
        for sign in signs:
            look = {"code": sign["mutcd"] or sign["vienna"]} | {n: sign[n] for n in LOOK[1:]}
            x, y = round(sign["x"], 2), round(sign["y"], 2)
            about = {"result": found.name, "look": look, "x": x, "y": y, "seen": found._seen(x, y)}
            own = tuple(views[sign["sign_id"]])
            found.rows[sign["sign_id"]] = Reviewed(ACCEPTED, sign["sign_id"], **about, views=own)
        return found

    def _seen(self, x: float, y: float) -> tuple[tuple[str, float, float], ...]:
        """The images whose cameras are nearest to a place of the world frame, and metres to the right and ahead."""
        found = []
        for image, camera in heapq.nsmallest(
            _IMAGES, self.cameras.items(), key=lambda one: abs(one[1]["place"] - complex(x, y))
        ):
            level = (complex(x, y) - camera["place"]) / camera["heading"]
            found.append((image, round(-level.imag, 2), round(level.real, 2)))
        return tuple(found)

    def place(self, one: Reviewed) -> tuple[float, float] | None:
        """World x, y of what a review places by images; None where the result has no camera of any."""
        for image, right, ahead in one.seen:
            if image in self.cameras:
                camera = self.cameras[image]
                where = camera["place"] + complex(ahead, -right) * camera["heading"]
                return round(where.real, 2), round(where.imag, 2)
        return None

    def described(self, x: float, y: float) -> dict[str, Any]:
        """Columns of `signs.parquet` that follow from a place alone, as far as the result tells them."""
        seen = self._seen(x, y)
        if not seen:
            return {}
        image, right, ahead = seen[0]
        camera, away = self.cameras[image], complex(ahead, -right)
        row: dict[str, Any] = {"best_frame": camera["frame"]}
        if camera["heading_deg"] is not None and camera["lon_deg"] is not None:
            north = away.conjugate() * np.exp(1j * math.radians(camera["heading_deg"]))
            scale = math.radians(EARTH_RADIUS_M)
            row |= {"lat_deg": camera["lat_deg"] + north.real / scale}
            shrink = math.cos(math.radians(camera["lat_deg"]))
            row |= {"lon_deg": camera["lon_deg"] + north.imag / scale / shrink}
        return row | self.measure((camera["station_m"] or 0.0) + away.real)

    def measure(self, station_m: float) -> dict[str, Any]:
        """The station with its route, measure and unit, from the nearest place where they are known."""
        if not self.measured:
            return {"station_m": station_m}
        near = min(self.measured, key=lambda one: abs(_station(one) - station_m))
        beyond = self.sense * (station_m - _station(near)) / MEASURE_UNITS[near["measure_unit"]]
        told = {name: near[name] for name in _MEASURE_COLUMNS}
        return told | {"station_m": station_m, "measure": near["measure"] + beyond}


def _camera(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of frames with the camera's axes in world axes, and its place and level direction as x + iy.

    Without a direction the camera is taken to look along x.
    """
    turn = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    quaternion = [row[name] for name in ("qx", "qy", "qz", "qw")]
    if None not in quaternion:
        turn = Rotation.from_quat(quaternion).as_matrix()
    ahead = complex(*turn[:2, 2])
    about = {"place": complex(row["x"], row["y"]), "heading": ahead / (abs(ahead) or 1.0)}
    return {**row, **about, "turn": turn[:2].ravel().tolist()}


def _station(row: Mapping[str, Any]) -> float:
    return float(row["station_m"])
