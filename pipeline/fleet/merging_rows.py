"""One cell of an inventory as rows of its tables."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from wayside.pipeline.files.parquet import (
    ParquetFile,
    choice,
    fixed_list,
    geoparquet_metadata,
    known,
    record_batch,
)
from wayside.pipeline.fleet.inventory_data import DriveSigns
from wayside.pipeline.fleet.recorded_settings import schema_with_settings
from wayside.schemas.inventory_tables import PANELS, SIGHTINGS, SUPPORTS
from wayside.schemas.settings import MergeSettings
from wayside.schemas.sightings import MergedPanels, Sightings
from wayside.schemas.tables import SIGN_STATUSES, Table
from wayside.stages.georeference import LocalOrigin

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_UPPER = np.triu_indices(3)
_RANK = tuple(SIGN_STATUSES)
"""Of several statuses the first counts: a face that one drive saw is a sign."""


@dataclass(frozen=True, slots=True)
class Block:
    """Sightings of a cell and its margin, with the drives they are of.

    `origin`: of their positions. `rows`: of each drive's table, one array for each of `drives`, in the order of the
    sightings. `cell` (n, 2): tile of each. `vector_m` (n, 3): of the whole drive, taken out of the positions.
    """

    origin: LocalOrigin
    drives: tuple[DriveSigns, ...]
    rows: tuple[Ints, ...]
    sightings: Sightings
    cell: Ints
    vector_m: Floats


@dataclass(frozen=True, slots=True)
class CellCounts:
    """Rows of the three tables."""

    panels: int
    supports: int
    sightings: int


def write_cell(
    part: Path,
    name: str,
    block: Block,
    merged: MergedPanels,
    own: NDArray[np.bool_],
    settings: MergeSettings,
) -> CellCounts:
    """Write the parts of the three tables that hold the sightings `own` (n,) of a block, merged by settings.

    Raises
    ------
    OSError
        They cannot be written.
    """
    rows = np.flatnonzero(own)
    seen = block.sightings.select(rows)
    columns = _columns(block, rows)
    kept, panel = np.unique(merged.panel[rows], return_inverse=True)
    order = np.lexsort((seen.row, seen.drive, seen.time_ns))
    ids = np.array(
        [f"{d}/{s}" for d, s in zip(columns["drive"], columns["sign_id"], strict=True)], object
    )
    panel_id = ids[order[_firsts(panel[order])]]
    support = np.unique(merged.support[kept], return_inverse=True)[1].ravel()
    by_id = np.argsort(panel_id, kind="stable")
    support_id = panel_id[by_id[_firsts(support[by_id])]]

    sightings = _sightings(block, merged, rows, columns, panel_id[panel])
    panels = _panels(block, merged, kept, panel, seen, columns)
    first_ns = np.array([seen.time_ns[r].min() for r in _members(panel)])
    before, after = _replaced(merged.place[kept], first_ns, panel_id)
    panels |= {
        "panel_id": panel_id,
        "support_id": support_id[support],
        "replaces": before,
        "replaced_by": after,
    }
    supports = _supports(block, merged.position[kept], support, panel_id) | {
        "support_id": support_id,
        **_history(seen, columns["drive"], _members(support[panel])),
        **_along_route(columns, _members(support[panel])),
    }
    for table, values, sort in (
        (PANELS, panels, panel_id),
        (SUPPORTS, supports, support_id),
        (SIGHTINGS, sightings, ids),
    ):
        order = np.argsort(sort, kind="stable")
        _write(part / table.name / f"cell={name}", table, values, order, settings)
    return CellCounts(len(kept), len(support_id), len(rows))


def _write(
    folder: Path, table: Table, values: dict[str, Any], order: Ints, settings: MergeSettings
) -> None:
    folder.mkdir()
    batch = record_batch(table, values).take(order)
    corners = [
        {axis: pc.min_max(batch[axis])[end].as_py() for axis in ("lon_deg", "lat_deg", "alt_m")}
        for end in ("min", "max")
    ]
    schema = schema_with_settings(table, merge=settings)
    with ParquetFile(folder / "part-0.parquet", schema, geoparquet_metadata(corners)) as sink:
        sink.write([batch])


def _columns(block: Block, rows: Ints) -> dict[str, NDArray[Any]]:
    """What the drives' tables say of some sightings, by column name, and the name of the drive."""
    names = (
        "sign_id",
        "status",
        "confidence",
        "up_m",
        "best_frame",
        "best_box",
        "route",
        "measure",
        "measure_unit",
        "mutcd",
        "vienna",
    )
    taken = [d.table.take(r) for d, r in zip(block.drives, block.rows, strict=True)]
    table = pa.concat_tables([t.select(names).unify_dictionaries() for t in taken]).take(rows)
    columns: dict[str, NDArray[Any]] = {
        name: np.asarray(table[name].cast(pa.string()).to_pylist(), object)
        for name in ("sign_id", "status", "route", "measure_unit", "mutcd", "vienna")
    }
    for name in ("confidence", "up_m", "measure"):
        columns[name] = np.asarray(table[name].cast(pa.float64()).to_numpy(), np.float64)
    box = np.array(table["best_box"].to_pylist(), np.float64).reshape(-1, 4)
    columns["frame"], columns["box"] = table["best_frame"].to_numpy(), box
    columns["area_px"] = (box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1])
    names_of = [
        np.full(len(r), d.name, object) for d, r in zip(block.drives, block.rows, strict=True)
    ]
    columns["drive"] = np.concatenate(names_of)[rows]
    return columns


def _sightings(
    block: Block,
    merged: MergedPanels,
    rows: Ints,
    columns: dict[str, NDArray[Any]],
    panel_id: NDArray[Any],
) -> dict[str, Any]:
    seen, offset = block.sightings.select(rows), merged.offset_m[rows]
    corrected = seen.position - offset
    offset = offset + block.vector_m[rows]
    away = np.linalg.norm(corrected - merged.position[merged.panel[rows]], axis=1)
    return {
        "panel_id": panel_id,
        "drive": columns["drive"],
        "sign_id": columns["sign_id"],
        "seen": _times(seen.time_ns),
        "frame": columns["frame"],
        "box": fixed_list(columns["box"], 4),
        "status": columns["status"],
        "confidence": known(columns["confidence"].astype(np.float32)),
        "color": choice(SIGHTINGS, "color", seen.color),
        "shape": choice(SIGHTINGS, "shape", seen.shape),
        **_on_globe(block.origin, corrected),
        **{
            f"offset_{a}_m": offset[:, i].astype(np.float32)
            for i, a in enumerate(("east", "north", "up"))
        },
        "from_panel_m": away.astype(np.float32),
    }


def _panels(
    block: Block,
    merged: MergedPanels,
    kept: Ints,
    panel: Ints,
    seen: Sightings,
    columns: dict[str, NDArray[Any]],
) -> dict[str, Any]:
    count, covariance = len(kept), merged.covariance[kept]
    sigma = np.sqrt(covariance[:, [0, 1, 2], [0, 1, 2]]).astype(np.float32)
    members = _members(panel)
    largest = np.array([r[np.argmax(columns["area_px"][r])] for r in members])
    rank = np.array([_RANK.index(status) for status in columns["status"]])
    weight = 1 / np.square(np.hypot(seen.size_sigma_m, 0.01))
    confidence = np.full(count, -np.inf)
    np.fmax.at(confidence, panel, columns["confidence"])
    return {
        "status": [_RANK[min(rank[r])] for r in members],
        "confidence": known(confidence.astype(np.float32)),
        "color": choice(PANELS, "color", np.array([_most(seen.color[r]) for r in members])),
        "shape": choice(PANELS, "shape", np.array([_most(seen.shape[r]) for r in members])),
        **_on_globe(block.origin, merged.position[kept]),
        "covariance": pa.FixedSizeListArray.from_arrays(
            pa.array(covariance[:, _UPPER[0], _UPPER[1]].ravel()), 6
        ),
        **{f"sigma_{a}_m": sigma[:, i] for i, a in enumerate(("east", "north", "alt"))},
        "bearing_deg": known(_mean_bearing(seen.bearing_rad, panel, count)),
        "panel_width_m": known(_mean(seen.size_m[:, 0], panel, count, weight[:, 0])),
        "panel_height_m": known(_mean(seen.size_m[:, 1], panel, count, weight[:, 1])),
        "up_m": known(_mean(columns["up_m"], panel, count)),
        **_history(seen, columns["drive"], members),
        "mutcd": columns["mutcd"][largest],
        "vienna": columns["vienna"][largest],
        "best_drive": columns["drive"][largest],
        "best_sign_id": columns["sign_id"][largest],
        **_along_route(columns, members),
    }


def _supports(
    block: Block, position: Floats, support: Ints, panel_id: NDArray[Any]
) -> dict[str, Any]:
    of_support = _members(support)
    middle = np.array([position[r].mean(axis=0) for r in of_support])
    return {
        **_on_globe(block.origin, middle),
        "panels": [len(r) for r in of_support],
        "panel_ids": [sorted(panel_id[r].tolist()) for r in of_support],
    }


def _along_route(columns: dict[str, NDArray[Any]], groups: list[Ints]) -> dict[str, Any]:
    """The columns of the route for groups of sightings: of the largest view of a drive that knew its route."""
    larger = np.where(np.isfinite(columns["measure"]), columns["area_px"], -1.0)
    best = np.array([rows[np.argmax(larger[rows])] for rows in groups])
    return {
        "route": columns["route"][best],
        "measure": known(columns["measure"][best]),
        "measure_unit": columns["measure_unit"][best],
    }


def _history(seen: Sightings, drive: NDArray[Any], groups: list[Ints]) -> dict[str, Any]:
    """When and by which drives groups of sightings were seen."""
    ordered = [rows[np.lexsort((drive[rows].astype(str), seen.time_ns[rows]))] for rows in groups]
    drives = [list(dict.fromkeys(drive[rows].tolist())) for rows in ordered]
    return {
        "first_seen": _times(np.array([seen.time_ns[rows[0]] for rows in ordered])),
        "last_seen": _times(np.array([seen.time_ns[rows[-1]] for rows in ordered])),
        "times_seen": [len(names) for names in drives],
        "drives": drives,
    }


def _replaced(
    place: Ints, first_ns: Ints, panel_id: NDArray[Any]
) -> tuple[list[str | None], list[str | None]]:
    """For each panel the one before and the one behind it in time at its place."""
    order = np.lexsort((first_ns, place))
    before: list[str | None] = [None] * len(place)
    after = before.copy()
    for one, other in pairwise(order.tolist()):
        if place[one] == place[other]:
            before[other], after[one] = panel_id[one], panel_id[other]
    return before, after


def _members(group: Ints) -> list[Ints]:
    """Rows of each group, in order; groups are numbered from 0 without gaps."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


def _firsts(group: Ints) -> Ints:
    """Where each group (n,) comes first, in order of the groups."""
    return np.asarray(np.unique(group, return_index=True)[1], np.int64)


def _most(codes: Ints) -> int:
    """The most frequent known code, the lowest of equals; -1: none."""
    known_codes = codes[codes >= 0]
    return int(np.bincount(known_codes).argmax()) if len(known_codes) else -1


def _mean(values: Floats, group: Ints, count: int, weight: Floats | None = None) -> Floats:
    """Weighted mean of the known values of each group; nan: none."""
    w = np.where(np.isfinite(values), 1.0 if weight is None else np.nan_to_num(weight), 0.0)
    total = np.bincount(group, w, count)
    mean = np.bincount(group, w * np.nan_to_num(values), count) / np.where(total > 0, total, np.nan)
    return np.asarray(mean, np.float32)


def _mean_bearing(bearing_rad: Floats, group: Ints, count: int) -> NDArray[np.float32]:
    """Mean direction of each group, degrees, 0 to 360; nan: unknown."""
    sine, cosine = (_mean(f(bearing_rad), group, count) for f in (np.sin, np.cos))
    return (np.degrees(np.arctan2(sine, cosine)) % 360).astype(np.float32)


def _on_globe(origin: LocalOrigin, points: Floats) -> dict[str, Any]:
    """Columns of a place, and its geometry as WKB Point Z."""
    geodetic = origin.geodetic(points)
    raw = np.zeros(len(points), np.dtype([("head", "<u1"), ("kind", "<u4"), ("at", "<f8", 3)]))
    raw["head"], raw["kind"], raw["at"] = 1, 1001, geodetic
    return {
        "lon_deg": geodetic[:, 0],
        "lat_deg": geodetic[:, 1],
        "alt_m": geodetic[:, 2],
        "geometry": [one.tobytes() for one in raw],
    }


def _times(time_ns: Ints) -> pa.Array[Any]:
    return pa.array(time_ns // 1000).cast(pa.timestamp("us", tz="UTC"))
