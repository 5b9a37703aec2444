"""Results of drives as `wayside run` would write them, made from exact truth without images.

Roads are parallel, 1.1 km apart and straight, with supports on both sides that face either direction.
A drive sees the panels that face it, some from behind, misses some, reads some wrong, and adds some that are none.
Its fixes err together: a Gauss-Markov process with a correlation time of a minute at 25 m/s, averaged over 100 m, since
the motion between images holds the path together. None of this is taken from the merging that it tests.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from wayside.pipeline.files.parquet import choice, fixed_list, record_batch
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.tables import FRAMES, SIGN_STATUSES, SIGNS, Table
from wayside.stages.georeference import LocalOrigin

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
DAY_NS = 86_400 * 10**9
YEAR_NS = 365 * DAY_NS
START_NS = 1_710_000_000 * 10**9
SPACING_M, SPEED_MPS, CORRELATION_S, SMOOTHED_M = 8.0, 25.0, 60.0, 100.0
CAMERA: dict[str, Any] = {"width": 1600, "height": 1200, "fx": 1400.0, "fy": 1400.0}
CAMERA |= {"cx": 799.5, "cy": 599.5, "distortion": []}
RANGE_PX = 12.0
"""Height at which a face is first measured."""
PER_PANEL = ("position", "forward", "turn_rad", "color", "shape", "size", "support", "identity")
LATERAL_SIGMA_M, ALONG_SIGMA_M, UP_SIGMA_M = 0.03, 0.07, 0.02


@dataclass(frozen=True, slots=True)
class Road:
    """The panels of a road; n rows.

    The position (n, 3) is in metres along the road (east), to its left (north) and up. A panel with `forward` (n,)
    faces those who drive east. Its face is turned by `turn_rad` (n,) against the road, and its number is `identity`.
    """

    origin: LocalOrigin
    length_m: float
    position: Floats
    forward: NDArray[np.bool_]
    turn_rad: Floats
    color: Ints
    shape: Ints
    size: Floats
    support: Ints
    identity: Ints

    def select(self, rows: Any) -> "Road":
        """Some of the panels."""
        return replace(self, **{name: getattr(self, name)[rows] for name in PER_PANEL})


@dataclass(frozen=True, slots=True)
class Quality:
    """How a drive measures.

    `fix_sigma_m`: level, 1.6 times as much in height. The others are shares: of panels and backs that are found, of
    faces read wrong, of rows that are no panel, and of measurements four times as far off.
    """

    fix_sigma_m: float = 1.0
    recall: float = 0.95
    back_recall: float = 0.4
    misread: float = 0.02
    false: float = 0.01
    outliers: float = 0.01


def make_road(number: int, length_m: float, spacing_m: float, rng: np.random.Generator) -> Road:
    """A road with a support about every `spacing_m`, of one to three panels."""
    supports = int(length_m / spacing_m)
    station = np.sort(rng.uniform(20, length_m - 20, supports))
    panels = rng.choice([1, 2, 3], supports, p=[0.7, 0.2, 0.1])
    support = np.repeat(np.arange(supports), panels)
    level = np.concatenate([np.arange(k) for k in panels])
    forward = rng.random(supports) < 0.6
    side = np.where(forward, -1.0, 1.0) * rng.uniform(5, 9, supports)
    n = len(support)
    size = rng.uniform(0.45, 1.1, supports)[support, None] * rng.uniform(0.8, 1.2, (n, 2))
    height = 2.0 + rng.uniform(0, 0.5, supports)[support] + level * 0.95
    position = np.column_stack([station[support], side[support], height])
    origin = LocalOrigin(38.0 + 0.01 * (number % 300), -99.0 + 0.6 * (number // 300), 400.0)
    return Road(
        origin,
        length_m,
        position,
        forward[support],
        np.radians(rng.normal(0, 3, n)),
        rng.integers(0, len(COLORS), n),
        rng.integers(0, len(SHAPES), n),
        size,
        support,
        number * 1_000_000 + np.arange(n),
    )


def change_road(
    road: Road, share: float, rng: np.random.Generator
) -> tuple[Road, dict[int, tuple[str, int | None]]]:
    """The road a year later: a share of the panels gone, moved, of another face, and as many put up as are gone.

    Another face has another colour; half of them also another shape and size.

    Returns
    -------
    The road, and by the identity of each panel before what became of it and the panel after; new ones by their own.
    """
    n = len(road.identity)
    kind = rng.choice(
        ["unchanged", "gone", "moved", "changed_face"],
        n,
        p=[1 - share, share * 0.3, share * 0.2, share * 0.5],
    )
    copied = ("position", "color", "shape", "size", "identity")
    after = replace(road, **{name: getattr(road, name).copy() for name in copied})
    history: dict[int, tuple[str, int | None]] = {}
    for row, what in enumerate(kind.tolist()):
        old = int(road.identity[row])
        if what == "moved":
            after.position[row, 0] += rng.choice([-1, 1]) * rng.uniform(3, 25)
        if what == "changed_face":
            after.color[row] = (after.color[row] + rng.integers(1, len(COLORS))) % len(COLORS)
            if rng.random() < 0.5:
                after.shape[row] = (after.shape[row] + rng.integers(1, len(SHAPES))) % len(SHAPES)
                after.size[row] *= rng.choice([0.75, 1.3])
        if what in ("moved", "changed_face"):
            after.identity[row] = old + 500_000
        history[old] = (what, None if what == "gone" else int(after.identity[row]))
    kept = after.select(kind != "gone")
    count = int((kind == "gone").sum())
    rows = rng.integers(0, n, count)
    fresh = road.select(rows)
    fresh.position[:, 0] = rng.uniform(20, road.length_m - 20, count)
    fresh.position[:, 2] = 2.2
    identity = road.identity[0] + 700_000 + np.arange(count)
    fresh = replace(
        fresh,
        identity=identity,
        support=road.support.max() + 1 + np.arange(count),
        color=rng.integers(0, len(COLORS), count),
    )
    history |= {int(one): ("new", int(one)) for one in identity}
    joined = {
        name: np.concatenate([getattr(kept, name), getattr(fresh, name)]) for name in PER_PANEL
    }
    return replace(road, **joined), history


def write_drive(
    folder: Path,
    road: Road,
    time_ns: int,
    eastward: bool,
    quality: Quality,
    rng: np.random.Generator,
    *,
    until_m: float | None = None,
) -> Ints:
    """Write the result of one drive along a road; identity (n,) of the rows of its signs, -1: none."""
    until = road.length_m if until_m is None else until_m
    along = np.arange(0.0, until, SPACING_M)
    sign = 1.0 if eastward else -1.0
    along = along if eastward else along[::-1]
    count = len(along)
    error = _common_error(count, quality.fix_sigma_m, rng)
    camera = np.column_stack([along, np.full(count, -1.8 * sign), np.full(count, 2.0)])
    station = np.arange(count) * SPACING_M
    frame_ns = time_ns + (station / SPEED_MPS * 1e9).astype(np.int64)
    _write_frames(folder, road.origin, camera + error, station, frame_ns, sign)

    ahead = (road.position[:, 0] - along[0]) * sign
    facing = road.forward == eastward
    first = np.minimum(CAMERA["fx"] * road.size[:, 1] / RANGE_PX, 150.0)
    within = (ahead > 20) & (ahead < count * SPACING_M)
    recall = np.where(facing, quality.recall, quality.back_recall)
    rows = np.flatnonzero(within & (rng.random(len(ahead)) < recall))
    rows = rows[np.argsort(ahead[rows], kind="stable")]
    best = np.clip(((ahead[rows] - 14) / SPACING_M).astype(np.int64), 0, count - 1)
    start = np.clip(((ahead[rows] - first[rows]) / SPACING_M).astype(np.int64), 0, best)
    truth = road.select(rows)
    seen = _measured(truth, ~facing[rows], error[best], quality, rng)
    side = seen.place - camera[best] - error[best]
    size = truth.size * (1 + rng.normal(0, 0.03, (len(rows), 2)))
    facing_deg = np.degrees(truth.turn_rad + rng.normal(0, 0.05, len(rows)))
    values = {
        "sign_id": [f"{folder.name}-{k:05d}" for k in range(1, len(rows) + 1)],
        "assembly_id": [f"{folder.name}-a{k:05d}" for k in truth.support],
        "log": [folder.name] * len(rows),
        "station_m": ahead[rows],
        "panel_width_m": size[:, 0].astype(np.float32),
        "panel_height_m": size[:, 1].astype(np.float32),
        "facing_deg": facing_deg.astype(np.float32),
        "best_frame": best.astype(np.int32),
        "best_time_ns": frame_ns[best],
        "best_box": _box(side, size, sign),
        "first_frame": start.astype(np.int32),
        "last_frame": best.astype(np.int32),
        "views": (best - start + 1).astype(np.int32),
    }
    values |= _places(road.origin, seen, side, sign, quality)
    _write(folder, SIGNS, values)
    about = {"wayside": "simulated", "log": f"{folder.name}.mcap", "world": "enu", "camera": CAMERA}
    (folder / "run.json").write_text(json.dumps(about))
    return seen.identity


@dataclass(frozen=True, slots=True)
class _Seen:
    """What a drive measures of n panels: place and standard deviations (n, 3), colours, shapes, which are backs."""

    place: Floats
    sigma: Floats
    color: Ints
    shape: Ints
    back: NDArray[np.bool_]
    identity: Ints


def _measured(
    truth: Road, back: NDArray[np.bool_], error: Floats, quality: Quality, rng: np.random.Generator
) -> _Seen:
    """Places, colours and shapes with their errors; some rows are no panel."""
    n = len(back)
    sigma = np.array([ALONG_SIGMA_M, LATERAL_SIGMA_M, UP_SIGMA_M]) * rng.uniform(0.6, 1.8, (n, 1))
    noise = rng.normal(0, 1, (n, 3)) * sigma * np.where(rng.random((n, 1)) < quality.outliers, 4, 1)
    place = truth.position + noise + error
    color, shape = (
        np.where(rng.random(n) < quality.misread, rng.integers(0, high, n), codes)
        for codes, high in ((truth.color, len(COLORS)), (truth.shape, len(SHAPES)))
    )
    false = rng.random(n) < quality.false
    place[false] += rng.normal(0, 1, (int(false.sum()), 3)) * [20, 1, 0.3]
    return _Seen(place, sigma, color, shape, back, np.where(false, -1, truth.identity))


def _box(side: Floats, size: Floats, sign: float) -> "pa.Array[Any]":
    """Boxes of panels of `size` (n, 2) at places (n, 3) from the camera that shows them best."""
    half = CAMERA["fx"] * size / (2 * np.maximum(np.abs(side[:, :1]), 4))
    away = CAMERA["fx"] / np.abs(side[:, 0])
    middle = np.column_stack(
        [CAMERA["cx"] - side[:, 1] * sign * away, CAMERA["cy"] - side[:, 2] * away]
    )
    return fixed_list(np.hstack([middle - half, middle + half]), 4)


def _places(
    origin: LocalOrigin, seen: _Seen, side: Floats, sign: float, quality: Quality
) -> dict[str, Any]:
    """Columns of what is measured, in the world, on the globe and from the camera."""
    n = len(side)
    total = np.sqrt(seen.sigma**2 + (np.array([1, 1, 1.6]) * quality.fix_sigma_m) ** 2)
    covariance = np.zeros((n, 6))
    covariance[:, [0, 3, 5]] = seen.sigma**2
    back = list(SIGN_STATUSES).index("back")
    return {
        "status": choice(SIGNS, "status", np.where(seen.back, back, 0)),
        "confidence": np.full(n, 0.95, np.float32),
        "color": choice(SIGNS, "color", np.where(seen.back, -1, seen.color)),
        "shape": choice(SIGNS, "shape", seen.shape),
        **_columns("xyz", seen.place),
        **_columns(("lon_deg", "lat_deg", "alt_m"), origin.geodetic(seen.place)),
        **_columns(("sigma_east_m", "sigma_north_m", "sigma_alt_m"), total.astype(np.float32)),
        "covariance": pa.FixedSizeListArray.from_arrays(pa.array(covariance.ravel()), 6),
        "lateral_m": -side[:, 1] * sign,
        "up_m": seen.place[:, 2],
        "sigma_width_m": np.full(n, 0.03, np.float32),
        "sigma_height_m": np.full(n, 0.03, np.float32),
        "right_m": -side[:, 1] * sign,
        "down_m": -side[:, 2],
        "ahead_m": np.abs(side[:, 0]),
    }


def _columns(names: Sequence[str], values: NDArray[np.floating[Any]]) -> dict[str, Any]:
    """Columns of a matrix by their names."""
    return {name: values[:, k] for k, name in enumerate(names)}


def _common_error(count: int, sigma_m: float, rng: np.random.Generator) -> Floats:
    """Error (count, 3) that the fixes give the path of a drive."""
    warm = 2 * int(SMOOTHED_M / SPACING_M)
    keep = np.exp(-SPACING_M / SPEED_MPS / CORRELATION_S)
    steps = rng.normal(0, 1, (count + 2 * warm, 3)) * np.sqrt(1 - keep**2)
    steps[0] = rng.normal(0, 1, 3)
    error = np.empty_like(steps)
    error[0] = steps[0]
    for k in range(1, len(steps)):
        error[k] = keep * error[k - 1] + steps[k]
    smooth = uniform_filter1d(error, int(SMOOTHED_M / SPACING_M), axis=0)[warm : warm + count]
    return np.asarray(smooth * sigma_m * [1, 1, 1.6])


def _write_frames(
    folder: Path, origin: LocalOrigin, centre: Floats, station: Floats, time_ns: Ints, sign: float
) -> None:
    count = len(centre)
    looks = np.array([[0, 0, 1.0], [-1.0, 0, 0], [0, -1.0, 0]]) * [[sign], [sign], [1]]
    quaternion = Rotation.from_matrix(looks).as_quat(canonical=True)
    values = {
        "frame": np.arange(count, dtype=np.int32),
        "log_time_ns": time_ns,
        "header_time_ns": time_ns,
        "status": ["used"] * count,
        **_columns("xyz", centre),
        **_columns(("qx", "qy", "qz", "qw"), np.tile(quaternion, (count, 1))),
        **_columns(("lon_deg", "lat_deg", "alt_m"), origin.geodetic(centre)),
        "station_m": station,
        "heading_deg": np.full(count, 90.0 if sign > 0 else 270.0, np.float32),
    }
    folder.mkdir(parents=True)
    _write(folder, FRAMES, values)


def _write(folder: Path, table: Table, values: dict[str, Any]) -> None:
    """Write a table; columns that are not given are null."""
    count = len(next(iter(values.values())))
    schema = table.schema
    nulls = {name: pa.nulls(count, schema.field(name).type) for name in schema.names}
    batch = record_batch(table, nulls | values)
    pq.write_table(pa.Table.from_batches([batch], schema), folder / table.file, compression="zstd")
