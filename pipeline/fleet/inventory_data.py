"""The result of a drive as merging needs it, and the cells that an inventory is parted by."""

from dataclasses import dataclass
from math import cos, radians
from pathlib import Path

import mercantile
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.code_words import code_of
from wayside.pipeline.fleet.straight_routes import column_of, place_frames, place_signs
from wayside.pipeline.results.result import read_table
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.settings.merging import MergeSettings
from wayside.schemas.sightings import Sightings
from wayside.schemas.sign_catalogue import CODES, US, VIENNA
from wayside.schemas.tables import FRAMES, SIGNS
from wayside.stages.georeference import LocalOrigin

COMMON_FLOOR_M = 0.02
"""Smallest standard deviation of the error common to neighbouring panels: carrier phase receivers."""
POSITION_FLOOR_M = 0.02
"""Smallest standard deviation of a panel relative to the cameras nearby: its thickness, seen from either side."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
METRES_PER_DEGREE = 111_320.0
_SIGNS = (
    "sign_id", "assembly_id", "status", "confidence", "color", "shape", "covariance", "station_m", "up_m",
    "panel_width_m", "panel_height_m", "sigma_width_m", "sigma_height_m", "facing_deg", "lon_deg", "lat_deg", "alt_m",
    "sigma_east_m", "sigma_north_m", "sigma_alt_m", "best_frame", "best_time_ns", "best_box", "first_frame", "route",
    "measure", "measure_unit", "mutcd", "vienna", "legend", "category", "code_probability", "lateral_m", "down_m",
    "sigma_along_m", "sigma_up_m",
)  # fmt: skip
_PLACE = ("lon_deg", "lat_deg", "alt_m")
_FRAMES = (
    "frame", "log_time_ns", "header_time_ns", "qx", "qy", "qz", "qw", *_PLACE, "heading_deg", "x", "y", "station_m",
)  # fmt: skip
_CODES: dict[tuple[str, str | None], int] = {one: number for number, one in enumerate(CODES)}
_SYMMETRIC = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])
_SHORTEST_STEP_M = 0.5


@dataclass(frozen=True, slots=True)
class DriveFrames:
    """Cameras of a drive with a place on WGS 84, in order; k rows."""

    frame: Ints
    """(k,)."""
    time_ns: Ints
    """(k,)."""
    geodetic: Floats
    """Longitude, latitude (deg), height (m), (k, 3)."""
    rotation: Floats
    """Camera to east, north, up, (k, 3, 3)."""
    turn: Floats
    """World frame to east, north, up, (k, 3, 3)."""
    travel_rad: Floats
    """Compass direction of travel, (k,)."""


@dataclass(frozen=True, slots=True)
class DriveSigns:
    """The signs of a drive with a place on WGS 84; n rows, in order of station."""

    name: str
    """Folder of the result."""
    table: pa.Table
    """Rows of `signs.parquet`."""
    geodetic: Floats
    """As of `DriveFrames`, (n, 3)."""
    sightings: Sightings
    """With positions still zero, `drive` 0."""
    cell: Ints
    """Tile x, y, (n, 2)."""


def read_frames(folder: Path) -> DriveFrames:
    """Where the cameras of a drive stood and looked; no rows without fixes or milepost, or of an earlier version.

    Raises InputError where the folder is no result folder, or damaged.
    """
    table = place_frames(folder, read_table(folder, FRAMES, _FRAMES))
    table = table.filter(pc.is_valid(table["heading_deg"]))
    geodetic, heading = _matrix(table, *_PLACE), column_of(table, "heading_deg")
    quaternions = _matrix(table, "qx", "qy", "qz", "qw")
    world = Rotation.from_quat(quaternions).as_matrix() if len(table) else np.zeros((0, 3, 3))
    turn = _turns(world, heading)
    time = pc.coalesce(table["header_time_ns"], table["log_time_ns"])
    return DriveFrames(
        np.asarray(table["frame"], np.int64),
        np.asarray(time, np.int64),
        geodetic,
        turn @ world,
        turn,
        _travel(geodetic, heading),
    )


def read_tiles(folder: Path, settings: MergeSettings) -> tuple[Ints, int]:
    """Tiles x, y (n, 2) of a drive's signs that have a place on WGS 84, and the number of those without.

    Raises as `read_frames`.
    """
    table = place_signs(folder, read_table(folder, SIGNS, _SIGNS))
    placed = table.filter(_is_placed(table))
    found = cells(_matrix(placed, "lon_deg", "lat_deg"), settings.cell_zoom)
    return found, len(table) - len(placed)


def read_signs(folder: Path, frames: DriveFrames, settings: MergeSettings) -> DriveSigns:
    """The signs of a drive that have a place on WGS 84. Raises as `read_frames`."""
    table = place_signs(folder, read_table(folder, SIGNS, _SIGNS))
    table = table.append_column("row", pa.array(np.arange(len(table))))
    table = table.filter(_is_placed(table))
    table = table.sort_by([("station_m", "ascending"), ("row", "ascending")]).combine_chunks()
    geodetic = _matrix(table, *_PLACE)
    back = np.asarray(table["status"].cast(pa.string()), object) == "back"
    best, facing = _matrix(table, "best_frame", "facing_deg").T
    at = np.searchsorted(frames.frame, best)
    placed = np.flatnonzero(at < len(frames.frame))
    travel, turn = np.full(len(table), np.nan), np.tile(np.eye(3), (len(table), 1, 1))
    travel[placed] = frames.travel_rad[at[placed]]
    turn[placed] = frames.turn[at[placed]]
    six = [one or [np.nan] * 6 for one in table["covariance"].to_pylist()]
    world = np.nan_to_num(np.array(six, np.float64).reshape(-1, 6)[:, _SYMMETRIC], nan=0.0)
    world = world.reshape(-1, 3, 3)
    covariance = turn @ world @ turn.transpose(0, 2, 1) + POSITION_FLOOR_M**2 * np.eye(3)
    total = np.square(_matrix(table, "sigma_east_m", "sigma_north_m", "sigma_alt_m"))
    shared = np.maximum(total - covariance[:, [0, 1, 2], [0, 1, 2]], COMMON_FLOOR_M**2)
    codes = [
        (US if row["mutcd"] else VIENNA, code_of(row))
        for row in table.select(("mutcd", "vienna", "legend")).to_pylist()
    ]
    assemblies = np.asarray(table["assembly_id"].to_pylist(), dtype=np.str_)
    sightings = Sightings(
        drive=np.zeros(len(table), np.int64),
        row=np.asarray(table["row"], np.int64),
        time_ns=np.asarray(table["best_time_ns"], np.int64),
        position=np.zeros((len(table), 3)),
        covariance=covariance,
        common_sigma_m=np.sqrt(np.column_stack([shared[:, :2].mean(axis=1), shared[:, 2]])),
        assembly=np.unique(assemblies, return_inverse=True)[1].ravel().astype(np.int64),
        color=_class(table, "color", COLORS),
        shape=_class(table, "shape", SHAPES),
        code=np.array([_CODES.get(one, -1) for one in codes], np.int64),
        front=~back,
        # the visible side looks about against the travel; of a back, the face looks along with it
        bearing_rad=travel + np.radians(np.nan_to_num(facing)) + np.where(back, 0.0, np.pi),
        size_m=_matrix(table, "panel_width_m", "panel_height_m"),
        size_sigma_m=_matrix(table, "sigma_width_m", "sigma_height_m"),
    )
    return DriveSigns(folder.name, table, geodetic, sightings, cells(geodetic, settings.cell_zoom))


def cells(geodetic: Floats, zoom: int) -> Ints:
    """Tile x, y (n, 2) of longitudes and latitudes; spherical Mercator, as `mercantile.tile` of each."""
    count = 1 << zoom
    sine = np.sin(np.radians(geodetic[:, 1]))
    x = geodetic[:, 0] / 360 + 0.5
    y = 0.5 - 0.25 * np.log((1 + sine) / (1 - sine)) / np.pi
    tile = np.clip(np.floor(np.column_stack([x, y]) * count), 0, count - 1)
    return np.asarray(tile, np.int64)


def cell_origin(x: int, y: int, zoom: int) -> LocalOrigin:
    """Centre of a tile, on the ellipsoid."""
    west, south, east, north = mercantile.bounds(x, y, zoom)
    return LocalOrigin((south + north) / 2, (west + east) / 2, 0.0)


def within(geodetic: Floats, x: int, y: int, zoom: int, margin_m: float) -> NDArray[np.bool_]:
    """Which points (n,) lie in a tile or within a margin around it."""
    west, south, east, north = mercantile.bounds(x, y, zoom)
    up = margin_m / METRES_PER_DEGREE
    side = up / max(cos(radians(north)), cos(radians(south)), 1e-6)
    lon, lat = geodetic[:, 0], geodetic[:, 1]
    inside = (lat >= south - up) & (lat <= north + up) & (lon >= west - side) & (lon <= east + side)
    return np.asarray(inside)


def _turns(world: Floats, heading_deg: Floats) -> Floats:
    """Rotations (k, 3, 3) about z from the world frame of cameras (k, 3, 3) to east, north, up, by their headings."""
    clockwise = np.radians(heading_deg) - np.arctan2(world[:, 0, 2], world[:, 1, 2])
    turn = np.zeros((len(world), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(clockwise)
    turn[:, 0, 1], turn[:, 1, 0] = np.sin(clockwise), -np.sin(clockwise)
    turn[:, 2, 2] = 1
    return turn


def _travel(geodetic: Floats, heading_deg: Floats) -> Floats:
    """Compass direction of travel (k,), rad: from the camera before to the next; where it stands, that it looks in."""
    if not len(geodetic):
        return np.zeros(0)
    ends = geodetic[np.minimum(np.arange(len(geodetic)) + 1, len(geodetic) - 1)]
    starts = geodetic[np.maximum(np.arange(len(geodetic)) - 1, 0)]
    step = (ends - starts)[:, :2] * METRES_PER_DEGREE
    step[:, 0] *= np.cos(np.radians(geodetic[:, 1]))
    moved = np.hypot(*step.T) > _SHORTEST_STEP_M
    return np.where(moved, np.arctan2(step[:, 0], step[:, 1]), np.radians(heading_deg))


def _matrix(table: pa.Table, *names: str) -> Floats:
    """Columns as numbers (n, names), null as nan."""
    return np.column_stack([column_of(table, name) for name in names])


def _class(table: pa.Table, name: str, known: tuple[str, ...]) -> Ints:
    """Codes of a class, -1 where null."""
    codes = {text: code for code, text in enumerate(known)}
    found = [codes.get(str(text), -1) for text in table[name].cast(pa.string()).to_pylist()]
    return np.array(found, np.int64)


def _is_placed(table: pa.Table) -> pa.BooleanArray:
    """Which signs have a place on WGS 84."""
    return pc.and_(pc.is_valid(table["lon_deg"]), pc.is_valid(table["sigma_east_m"]))
