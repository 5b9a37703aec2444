"""One cell of an inventory as rows of its tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.code_words import statement_of
from wayside.pipeline.files.parquet import geoparquet_metadata, parquet_file, record_batch
from wayside.pipeline.fleet.folders import CELL, schema_with_settings
from wayside.pipeline.fleet.inventory_data import DriveSigns, Floats, Ints
from wayside.pipeline.fleet.straight_routes import without_place
from wayside.pipeline.results.routes import Row
from wayside.pipeline.results.rows import located
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.inventory_tables import PANELS, SIGHTINGS, SUPPORTS
from wayside.schemas.settings import MergeSettings
from wayside.schemas.sightings import MergedPanels, Sightings
from wayside.schemas.sign_catalogue import CATEGORIES
from wayside.schemas.tables import SIGN_STATUSES, Table
from wayside.stages.georeference import LocalOrigin

_TOLD = (
    "sign_id", "status", "confidence", "up_m", "best_frame", "best_box", "mutcd", "vienna", "category", "legend",
    "code_probability", "route", "measure", "measure_unit",
)  # fmt: skip
_RANK = tuple(SIGN_STATUSES)
"""Of several statuses the first counts: a face that one drive saw is a sign."""
_SIZE_FLOOR_M = 0.01


@dataclass(frozen=True, slots=True)
class Block:
    """Sightings of a cell and its margin, with the drives they are of; n sightings."""

    origin: LocalOrigin
    """Of their positions."""
    drives: tuple[DriveSigns, ...]
    rows: tuple[Ints, ...]
    """Of the table of each drive, in the order of the sightings."""
    sightings: Sightings
    cell: Ints
    """Tile x, y of each, (n, 2)."""
    vector_m: Floats
    """Of the whole drive, taken out of the positions, (n, 3)."""

    def told(self) -> list[Row]:
        """What the tables of the drives say of each sighting."""
        return [
            row | {"drive": drive.name}
            for drive, rows in zip(self.drives, self.rows, strict=True)
            for row in drive.table.select(_TOLD).take(rows).to_pylist()
        ]


def write_cell(
    part: Path,
    name: str,
    block: Block,
    merged: MergedPanels,
    own: NDArray[np.bool_],
    settings: MergeSettings,
) -> tuple[int, int, int]:
    """Write the sightings `own` (n,) of a block, merged by settings; rows of panels, supports and sightings.

    Raises OSError where the parts of the three tables cannot be written.
    """
    rows = np.flatnonzero(own)
    told = block.told()
    cell = _Cell(block.sightings.select(rows), [told[k] for k in rows.tolist()])
    kept, panel = np.unique(merged.panel[rows], return_inverse=True)
    members = _members(panel)
    panel_id = [cell.sign_id(min(own, key=cell.order)) for own in members]
    support = np.unique(merged.support[kept], return_inverse=True)[1].ravel()
    of_support = [[panel_id[k] for k in one] for one in _members(support)]
    before, after = _replaced(
        merged.place[kept], [min(cell.time_ns[k] for k in own) for own in members], panel_id
    )
    position, covariance = merged.position[kept], merged.covariance[kept]
    panels = [
        cell.panel(own, covariance[k])
        | place
        | {"panel_id": panel_id[k], "support_id": min(of_support[support[k]])}
        | {"replaces": before[k], "replaced_by": after[k]}
        for k, (own, place) in enumerate(zip(members, _places(block.origin, position), strict=True))
    ]
    middle = np.array([position[one].mean(axis=0) for one in _members(support)])
    supports = [
        cell.history(own)
        | place
        | {"support_id": min(ids), "panels": len(ids), "panel_ids": sorted(ids)}
        for ids, own, place in zip(
            of_support, _members(support[panel]), _places(block.origin, middle), strict=True
        )
    ]
    offset = merged.offset_m[rows]
    corrected = cell.seen.position - offset
    away = np.linalg.norm(corrected - merged.position[merged.panel[rows]], axis=1)
    sightings = [
        cell.sighting(k, total) | place | {"panel_id": panel_id[panel[k]], "from_panel_m": away[k]}
        for k, (total, place) in enumerate(
            zip(offset + block.vector_m[rows], _places(block.origin, corrected), strict=True)
        )
    ]
    panels.sort(key=lambda row: row["panel_id"])
    supports.sort(key=lambda row: row["support_id"])
    sightings.sort(key=lambda row: f"{row['drive']}/{row['sign_id']}")
    for table, found in ((PANELS, panels), (SUPPORTS, supports), (SIGHTINGS, sightings)):
        _write(part / table.name / f"{CELL}{name}", table, found, settings)
    return len(panels), len(supports), len(sightings)


class _Cell:
    """The sightings of a cell, n rows, with what the drives told of each."""

    def __init__(self, seen: Sightings, told: list[Row]) -> None:
        self.seen, self._told, self.time_ns = seen, told, seen.time_ns.tolist()
        self._drive, self._row = seen.drive.tolist(), seen.row.tolist()
        box = np.array([one["best_box"] for one in told], np.float64)
        self._area = ((box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1])).tolist()

    def order(self, k: int) -> tuple[int, int, int]:
        """Sightings in order of time."""
        return self.time_ns[k], self._drive[k], self._row[k]

    def sign_id(self, k: int) -> str:
        """The drive and its row, in a text."""
        return f"{self._told[k]['drive']}/{self._told[k]['sign_id']}"

    def sighting(self, k: int, offset: Floats) -> Row:
        """Columns of one sighting, whose drive was off by offset (3,)."""
        told = self._told[k]
        return {
            **{name: told[name] for name in ("drive", "sign_id", "status", "confidence")},
            "seen": self.time_ns[k] // 1000,
            "frame": told["best_frame"],
            "box": told["best_box"],
            "color": _named(COLORS, self.seen.color[k]),
            "shape": _named(SHAPES, self.seen.shape[k]),
            **{f"offset_{a}_m": offset[i] for i, a in enumerate(("east", "north", "up"))},
        }

    def panel(self, own: Sequence[int], covariance: Floats) -> Row:
        """Columns of the panel that some of the sightings are of."""
        told, seen = [self._told[k] for k in own], self.seen.select(np.array(own))
        confidence = [one["confidence"] for one in told if one["confidence"] is not None]
        largest = self._told[max(own, key=lambda k: self._area[k])]
        weight = 1 / np.square(np.hypot(seen.size_sigma_m, _SIZE_FLOOR_M))
        east, north = (_mean(of(seen.bearing_rad)) for of in (np.sin, np.cos))
        bearing = (
            None if east is None or north is None else np.degrees(np.arctan2(east, north)) % 360
        )
        return {
            "status": min((one["status"] for one in told), key=_RANK.index),
            "confidence": max(confidence, default=None),
            "color": _named(COLORS, _most(seen.color)),
            "shape": _named(SHAPES, _most(seen.shape)),
            **agreed_code(told),
            "covariance": covariance[np.triu_indices(3)],
            **{
                f"sigma_{a}_m": covariance[i, i] ** 0.5
                for i, a in enumerate(("east", "north", "alt"))
            },
            "bearing_deg": bearing,
            "panel_width_m": _mean(seen.size_m[:, 0], weight[:, 0]),
            "panel_height_m": _mean(seen.size_m[:, 1], weight[:, 1]),
            "up_m": _mean(np.array([one["up_m"] for one in told], np.float64)),
            "best_drive": largest["drive"],
            "best_sign_id": largest["sign_id"],
            **self.history(own),
        }

    def history(self, own: Sequence[int]) -> Row:
        """When and by which drives some of the sightings were made, and the route by the largest view that knew it."""
        ordered = sorted(own, key=lambda k: (self.time_ns[k], self._told[k]["drive"]))
        drives = list(dict.fromkeys(self._told[k]["drive"] for k in ordered))
        knew = [k for k in own if self._told[k]["measure"] is not None] or own
        route = self._told[max(knew, key=lambda k: self._area[k])]
        return {
            "first_seen": self.time_ns[ordered[0]] // 1000,
            "last_seen": self.time_ns[ordered[-1]] // 1000,
            "times_seen": len(drives),
            "drives": drives,
            **{name: route[name] for name in ("route", "measure", "measure_unit")},
        }


def agreed_code(told: Sequence[Row]) -> Row:
    """Code, legend and category by what the drives say of one panel: the narrowest that more of them say than deny.

    A wider statement denies none that is narrower: where two read different legends or codes, what is common is left.
    """
    said = [(statement_of(row), row) for row in told]
    best: tuple[str, ...] = ()
    for one in {path[:depth] for path, _ in said for depth in range(1, len(path) + 1)}:
        agree = sum(path[: len(one)] == one for path, _ in said)
        deny = sum(path[: len(one)] != one[: len(path)] for path, _ in said)
        best = max(best, one, key=len) if agree > deny else best
    denied = [0.0 for path, _ in said if path[: len(best)] != best[: len(path)]]
    own = [row for path, row in said if path[: len(best)] == best]
    coded = [row for row in own if len(best) > 1]
    code, _, legend = best[-1].partition(" ") if coded else ("", "", "")
    known = [row["code_probability"] for row in coded if row["code_probability"] is not None]
    return {
        "mutcd": code if coded and coded[0]["mutcd"] else None,
        "vienna": code if coded and coded[0]["vienna"] else None,
        "category": best[0] if best and best[0] in CATEGORIES else None,
        "legend": legend or None,
        "code_probability": float(np.mean(known + denied)) if known else None,
    }


def _write(folder: Path, table: Table, rows: list[Row], settings: MergeSettings) -> None:
    folder.mkdir()
    rows = [{"lateral_m": None} | without_place(row) for row in rows]
    batch = record_batch(table, {n: [row[n] for row in rows] for n in table.schema.names})
    schema = schema_with_settings(table, merge=settings)
    with parquet_file(folder / "part-0.parquet", schema, geoparquet_metadata(rows)) as sink:
        sink.write_batch(batch)


def _replaced(
    place: Ints, first_ns: list[int], panel_id: list[str]
) -> tuple[list[str | None], list[str | None]]:
    """For each panel the one before and the one behind it in time at its place."""
    order = np.lexsort((np.array(first_ns), place))
    before: list[str | None] = [None] * len(place)
    after = before.copy()
    for one, other in pairwise(order.tolist()):
        if place[one] == place[other]:
            before[other], after[one] = panel_id[one], panel_id[other]
    return before, after


def _members(group: Ints) -> list[list[int]]:
    """Rows of each group, in order; groups are numbered from 0 without gaps."""
    order = np.argsort(group, kind="stable")
    return [own.tolist() for own in np.split(order, np.flatnonzero(np.diff(group[order])) + 1)]


def _named(names: Sequence[str], code: int) -> str | None:
    return names[code] if code >= 0 else None


def _most(codes: Ints) -> int:
    """The most frequent known code, the lowest of equals; -1: none."""
    known = codes[codes >= 0]
    return int(np.bincount(known).argmax()) if len(known) else -1


def _mean(values: Floats, weight: Floats | None = None) -> float | None:
    """Weighted mean of the known values; None: none."""
    w = np.where(np.isfinite(values), 1.0 if weight is None else np.nan_to_num(weight), 0.0)
    return float(w @ np.nan_to_num(values) / w.sum()) if w.sum() > 0 else None


def _places(origin: LocalOrigin, points: Floats) -> list[Row]:
    """Columns of each place (n, 3) about an origin."""
    return [located(*place) for place in origin.geodetic(points).tolist()]
