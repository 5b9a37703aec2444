"""Where a sign stands that no row has: seen from an image, along the road, on the globe and along its route."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.results.result import read_rows, read_run
from wayside.pipeline.reviewing.entries import Reviewed
from wayside.schemas.routes import MEASURE_UNITS
from wayside.schemas.tables import FRAMES, SIGNS

_COLUMNS = (
    *("frame", "log_time_ns", "image_name", "status", "x", "y", "qx", "qy", "qz", "qw"),
    *("station_m", "lon_deg", "lat_deg"),
)


def image_key(frame: Mapping[str, Any]) -> str:
    """What names an image in every result of its drive: its file, else its log time; frames are numbered anew."""
    return str(frame.get("image_name") or frame["log_time_ns"])


@dataclass(frozen=True, slots=True)
class Places:
    """The cameras of a drive, by which a place of one result is found again in another."""

    images: frozenset[str]
    """Keys of all images that were looked at."""
    cameras: tuple[dict[str, Any], ...]
    """Rows of `frames.parquet` with a place, each with its `image`."""
    measured: tuple[dict[str, Any], ...]
    """Stations with their `route`, `measure` and `measure_unit`: the start of a drive with a milepost, else signs."""
    sense: float
    """1: measures rise in the direction of travel, -1: they fall."""

    @classmethod
    def of(cls, out: Path) -> Places:
        """Those of a result; raises InputError if the folder is none, or damaged."""
        rows = read_rows(out, FRAMES, _COLUMNS)
        images = frozenset(image_key(row) for row in rows if row["status"] == "used")
        known = [row | {"image": image_key(row)} for row in rows if row["x"] is not None]
        columns = ("station_m", "route", "measure", "measure_unit")
        signs = [row for row in read_rows(out, SIGNS, columns) if row["measure"] is not None]
        asked = (read_run(out).get("settings") or {}).get("route", {})
        if asked.get("milepost", -1.0) >= 0:  # as in `measure_along_route`
            sense = -1.0 if asked["decreasing"] else 1.0
            at_start = (0.0, asked["name"] or None, asked["milepost"], asked["unit"])
            return cls(images, tuple(known), (dict(zip(columns, at_start, strict=True)),), sense)
        signs.sort(key=lambda sign: float(sign["station_m"]))
        falls = bool(signs) and signs[-1]["measure"] < signs[0]["measure"]
        return cls(images, tuple(known), tuple(signs), -1.0 if falls else 1.0)

    def nearest(self, x: float, y: float) -> dict[str, Any] | None:
        """The camera nearest to a place of the world frame; None where the result has no path."""
        return min(
            self.cameras, key=lambda one: float(np.hypot(one["x"] - x, one["y"] - y)), default=None
        )

    def anchor(self, x: float, y: float, frame: int | None = None) -> dict[str, Any]:
        """A place as metres to the right and ahead of a frame (None: the nearest), where it has a camera."""
        camera = next((one for one in self.cameras if one["frame"] == frame), self.nearest(x, y))
        if camera is None:
            return {}
        right, ahead = (_level(camera).T @ [x - camera["x"], y - camera["y"]]).tolist()
        return {"image": camera["image"], "right_m": round(right, 2), "ahead_m": round(ahead, 2)}

    def place(self, one: Reviewed) -> tuple[float, float] | None:
        """World x, y of what a review places by an image; None where the result has no camera of that image."""
        camera = next((row for row in self.cameras if row["image"] == one.image), None)
        if camera is None or one.right_m is None or one.ahead_m is None:
            return None
        x, y = _level(camera) @ [one.right_m, one.ahead_m] + [camera["x"], camera["y"]]
        return float(x), float(y)

    def described(self, x: float, y: float) -> dict[str, Any]:
        """Columns of `signs.parquet` that follow from a place alone, as far as the result tells them."""
        camera = self.nearest(x, y)
        if camera is None:
            return {}
        station = (camera["station_m"] or 0.0) + float(
            _level(camera)[:, 1] @ [x - camera["x"], y - camera["y"]]
        )
        row = {"station_m": station, "best_frame": camera["frame"]}
        return row | self._globe(x, y) | self.measure(station)

    def measure(self, station_m: float) -> dict[str, Any]:
        """Route, measure and its unit at a station, from the nearest one where they are known; empty without."""
        if not self.measured:
            return {}
        near = min(self.measured, key=lambda one: abs(float(one["station_m"]) - station_m))
        beyond = (station_m - near["station_m"]) / MEASURE_UNITS[near["measure_unit"]]
        return near | {"station_m": station_m, "measure": near["measure"] + self.sense * beyond}

    def _globe(self, x: float, y: float) -> dict[str, float]:
        """Longitude and latitude, by the similarity between both frames of the cameras (least squares)."""
        rows = [one for one in self.cameras if one["lon_deg"] is not None]
        world = np.array([complex(one["x"], one["y"]) for one in rows])
        if len({*world}) < 2:
            return {}
        lon, lat = (np.array([one[name] for one in rows]) for name in ("lon_deg", "lat_deg"))
        shrink = np.cos(np.radians(lat[0]))
        globe = (lon - lon[0]) * shrink + 1j * (lat - lat[0])
        known = np.stack([world, np.ones(len(rows))], axis=1)
        factor, start = np.linalg.lstsq(known, globe, rcond=None)[0]
        moved = factor * complex(x, y) + start
        return {
            "lon_deg": float(lon[0] + moved.real / shrink),
            "lat_deg": float(lat[0] + moved.imag),
        }


def turn_of(row: Mapping[str, Any]) -> NDArray[np.float64]:
    """Camera axes of a row of frames in world axes (3, 3); without a direction, of a camera that looks along x."""
    quaternion = [row[name] for name in ("qx", "qy", "qz", "qw")]
    if None in quaternion:
        return np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return np.asarray(Rotation.from_quat(quaternion).as_matrix(), np.float64)


def _level(camera: Mapping[str, Any]) -> NDArray[np.float64]:
    """Columns: right and ahead of a camera along world x, y; (2, 2)."""
    x, y = turn_of(camera)[:2, 2]
    length = float(np.hypot(x, y)) or 1.0
    return np.array([[y, x], [-x, y]]) / length
