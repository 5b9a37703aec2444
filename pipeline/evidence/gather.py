"""The rows of a result's tables that belong to a sign, put together for drawing."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.results.result import find_sign, read_rows
from wayside.pipeline.results.routes import with_route
from wayside.schemas.errors import InputError
from wayside.schemas.settings import RouteSettings
from wayside.schemas.tables import FRAMES, OBSERVATIONS, POSTS, PROFILE, SIGNS
from wayside.stages.geometry import turn_deg

_LONGEST_ID = 240
_FRAME_COLUMNS = (
    *("frame", "log_time_ns", "status", "x", "y", "z", "lon_deg", "lat_deg"),
    *("image_name", "image_date"),
)
_STRIP_COLUMNS = ("station_m", "offset_m", "height_m")
_STRIP_M, _LEAST_KNOWN = (8.0, 1.0), 0.5
"""Distance of strips along the road and across it."""
_SIGN_COLUMNS = tuple(column.name for column in SIGNS.columns if column.name != "geometry")


@dataclass(frozen=True, slots=True)
class SignView:
    """One measurement of a sign."""

    frame: int
    box: tuple[float, float, float, float]
    """x0, y0, x1, y1, half open, pixels."""
    residual_px: float | None
    range_m: float | None


@dataclass(frozen=True, slots=True)
class Evidence:
    """A sign with what it rests on."""

    sign: dict[str, Any]
    """Its row of `signs.parquet` by column name."""
    views: tuple[SignView, ...]
    """Its measurements in order of frame, at least one."""

    @property
    def name(self) -> str:
        """The sign's id."""
        return str(self.sign["sign_id"])

    @property
    def best(self) -> SignView:
        """The view to show large: that of `best_frame`, else the one of most pixels."""

        def merit(view: SignView) -> tuple[bool, float]:
            x0, y0, x1, y1 = view.box
            return view.frame == self.sign["best_frame"], (x1 - x0) * (y1 - y0)

        return max(self.views, key=merit)


@dataclass(frozen=True, slots=True)
class Globe:
    """Where the world frame lies on the globe, plane over the length of a drive."""

    turn: NDArray[np.float64]
    """Matrix (2, 2) that turns rows x, y to east, north."""
    lon_deg: float
    """Of the origin of the world frame."""
    lat_deg: float
    """Of the origin."""
    lat_deg_per_m: float
    """Degrees of latitude for a metre to the north."""

    @property
    def lon_deg_per_m(self) -> float:
        """Degrees of longitude for a metre to the east."""
        return self.lat_deg_per_m / math.cos(math.radians(self.lat_deg))


@dataclass(frozen=True, slots=True)
class DriveMap:
    """Cameras and signs of a whole drive, world frame, metres."""

    cameras: dict[int, NDArray[np.float64]]
    """Centre (3,) by frame."""
    path: NDArray[np.float64]
    """The same in order, (n, 3)."""
    signs: NDArray[np.float64]
    """All of them, (m, 3)."""
    log_times_ns: dict[int, int]
    """By frame."""
    images: dict[int, tuple[str, str]] = field(default_factory=dict)
    """Name and date of the file that was imported, by frame."""
    globe: Globe | None = None
    """Where the world frame lies; None where it is not known."""


def gather(
    out: Path, sign_id: str | None, route: RouteSettings | None = None
) -> tuple[DriveMap, list[Evidence]]:
    """The drive of a result and the evidence of its signs (None: of all), in order of `signs.parquet`.

    `route`: instead of that of the run. Raises UsageError where there is no such sign; the nearest known
    one is offered. Raises InputError where the folder is no result folder, or damaged.
    """
    signs = with_route(out, read_rows(out, SIGNS, _SIGN_COLUMNS), route)
    for sign in signs:
        _require_file_name(out, sign["sign_id"])
    chosen = signs if sign_id is None else [find_sign(out, signs, sign_id)]
    drive = drive_map(read_rows(out, FRAMES, _FRAME_COLUMNS), signs)
    grounds, posts = _grounds_below(out, chosen), {}
    if (out / POSTS.file).is_file():
        posts = {row["assembly_id"]: row for row in read_rows(out, POSTS, POSTS.schema.names)}
    chosen = [
        sign | {"ground_m": ground, "posts": posts.get(sign["assembly_id"])}
        for sign, ground in zip(chosen, grounds, strict=True)
    ]
    where = {"verdict": "sign"} if sign_id is None else {"verdict": "sign", "sign_id": sign_id}
    views = defaultdict(list)
    for row in read_rows(out, OBSERVATIONS, ("sign_id", "frame", "box", "residual_px"), where):
        views[row["sign_id"]].append(row)
    return drive, [_evidence(sign, views[sign["sign_id"]], drive) for sign in chosen]


def _grounds_below(out: Path, signs: Sequence[dict[str, Any]]) -> list[float | None]:
    """Height of the ground below each sign above the road, metres; None: not measured there, or not asked for.

    Interpolated between the strips around it, of which those that are measured must make up half.
    """
    if not (out / PROFILE.file).is_file():
        return [None] * len(signs)
    rows = read_rows(out, PROFILE, _STRIP_COLUMNS, {"status": "ground"})
    strips = np.array([[row[name] for name in _STRIP_COLUMNS] for row in rows]).reshape(-1, 3)
    found: list[float | None] = []
    for sign in signs:
        place = np.array([sign["station_m"], sign["lateral_m"]], np.float64)  # nan: not known
        weight = np.maximum(1 - np.abs(strips[:, :2] - place) / _STRIP_M, 0.0).prod(axis=1)
        known = weight.sum() >= _LEAST_KNOWN
        found.append(float(weight @ strips[:, 2] / weight.sum()) if known else None)
    return found


def drive_map(frames: Sequence[dict[str, Any]], signs: Sequence[dict[str, Any]]) -> DriveMap:
    """The drive by rows of `frames.parquet` and `signs.parquet`."""
    placed = [row for row in frames if row["x"] is not None]
    path = _positions(placed)
    named = [row for row in frames if row.get("image_name")]
    return DriveMap(
        {row["frame"]: centre for row, centre in zip(placed, path, strict=True)},
        path,
        _positions(signs),
        {row["frame"]: row["log_time_ns"] for row in frames},
        {r["frame"]: (visible(r["image_name"]), visible(r.get("image_date") or "")) for r in named},
        _globe([row for row in placed if row["lon_deg"] is not None]),
    )


def _globe(located: list[dict[str, Any]]) -> Globe | None:
    """Where the world frame lies, by cameras that are known in both; None where they do not differ.

    Least squares for the turn and scale that take x, y to east, north, as a complex factor.
    """
    if not located:
        return None
    lon, lat, x, y = (
        np.array([row[name] for row in located], np.float64)
        for name in ("lon_deg", "lat_deg", "x", "y")
    )
    east = turn_deg(lon[0], lon) * np.cos(np.radians(lat[0]))
    world, globe = x + 1j * y, east + 1j * (lat - lat[0])
    apart = world - world.mean()
    factor = np.vdot(apart, globe - globe.mean()) / max(np.vdot(apart, apart).real, 1e-12)
    if factor == 0:
        return None
    origin, unit = globe.mean() - factor * world.mean(), factor / abs(factor)
    turn = np.array([[unit.real, unit.imag], [-unit.imag, unit.real]])
    lon_deg = float(lon[0] + origin.real / np.cos(np.radians(lat[0])))
    return Globe(turn, lon_deg, float(lat[0] + origin.imag), float(abs(factor)))


def _positions(rows: Sequence[dict[str, Any]]) -> NDArray[np.float64]:
    """x, y, z of every row, (n, 3)."""
    return np.array([[row[axis] for axis in "xyz"] for row in rows], np.float64).reshape(-1, 3)


def _evidence(sign: dict[str, Any], rows: list[dict[str, Any]], drive: DriveMap) -> Evidence:
    """A sign with its views; a sign without any has its best box alone."""
    best = {"frame": sign["best_frame"], "box": sign["best_box"], "residual_px": None}
    position = _positions([sign])[0]
    views = []
    for row in sorted(rows or [best], key=lambda row: int(row["frame"])):
        if row["frame"] not in drive.log_times_ns:
            raise InputError(
                f"{sign['sign_id']} was measured in frame {row['frame']}, which {FRAMES.file} does not hold; "
                "the tables are of different runs: run the log again"
            )
        camera = drive.cameras.get(row["frame"])
        distance = None if camera is None else float(np.linalg.norm(position - camera))
        views.append(SignView(row["frame"], tuple(row["box"]), row["residual_px"], distance))
    name, date = drive.images.get(sign["best_frame"], ("", ""))
    return Evidence(sign | {"image_name": name, "image_date": date}, tuple(views))


def _require_file_name(out: Path, name: str) -> None:
    """Refuse an id that names a file outside of the folder of the sheets, because the table may be from anybody."""
    led_out = {"/", "\\", "\0"} & {*name} or name in ("", ".", "..")
    if led_out or len(name.encode()) > _LONGEST_ID or not name.isprintable():
        raise InputError(
            f"{out / SIGNS.file}: the sign id {visible(name[:80])!r} cannot name a file: the table was not written by "
            "wayside. Run the log again."
        )
