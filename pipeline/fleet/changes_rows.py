"""Rows of the comparison of two surveys, and what of a panel they are made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.fleet.inventory_data import METRES_PER_DEGREE
from wayside.stages.geometry import turn_deg
from wayside.stages.inventory import FACING_DEG, PanelPlaces

SAME_SIZE = 0.15
"""A panel that was moved keeps its width and height to this fraction: three standard deviations of two sizes."""

Row = dict[str, Any]
PANEL_COLUMNS = (
    "panel_id", "support_id", "replaces", "replaced_by", "status", "color", "shape", "lon_deg", "lat_deg", "alt_m",
    "bearing_deg", "panel_width_m", "panel_height_m", "route", "measure", "measure_unit", "geometry",
)  # fmt: skip


def row_of(
    change: str,
    panels: dict[str, Row],
    seen: dict[str, dict[str, list[Row]]],
    before: str | None,
    after: str | None,
) -> Row:
    """A row with the last image of each survey, without what only the other survey's images say."""
    row: Row = {"change": change}
    for side, name in (("before", before), ("after", after)):
        drives = {one["drive"]: one for one in seen[side][name]} if name is not None else {}
        row |= {f"panel_{side}": name, f"hidden_{side}": 0}
        row |= {f"{count}_{side}": len(drives) for count in ("drives", "seen")}
        if name is not None:
            row |= {k: panels[name][k] for k in PANEL_COLUMNS}
            row |= {f"{k}_{side}": panels[name][k] for k in ("color", "shape")}
            last = max(seen[side][name], key=lambda one: (one["seen"], one["drive"]))
            row |= {f"{k}_{side}": last[k] for k in ("drive", "frame", "box")}
    return row


def confidence_of(sightings: Sequence[Row]) -> float:
    """That at least one of the sightings is right; the presets of the report state no confidence."""
    stated = [one["confidence"] for one in sightings]
    return float(1 - np.prod([0.0 if one is None else 1 - one for one in stated]))


def successor(name: str, panels: dict[str, Row], after: dict[str, list[Row]]) -> str | None:
    """The panel that stands where one stood and that the later survey saw."""
    following = panels[name]["replaced_by"]
    while following is not None and following in panels:
        if after[following]:
            return str(following)
        following = panels[following]["replaced_by"]
    return None


def places_of(rows: Sequence[Row]) -> PanelPlaces:
    """Where panels are; `position` is longitude, latitude and height."""

    def numbers(*names: str) -> NDArray[np.float64]:
        return np.array(
            [[np.nan if r[n] is None else r[n] for n in names] for r in rows], np.float64
        )

    size = numbers("panel_width_m", "panel_height_m")
    return PanelPlaces(
        numbers("lon_deg", "lat_deg", "alt_m"),
        np.radians(numbers("bearing_deg")[:, 0]),
        np.where(np.isfinite(size), size, 0.6),
    )


def same_face(one: Row, other: Row) -> bool:
    """Whether two panels look alike: colour, shape, size and facing; what is not known of either tells nothing."""
    looks = ((one[name], other[name]) for name in ("color", "shape"))
    same = all(None in pair or pair[0] == pair[1] for pair in looks)
    for name in ("panel_width_m", "panel_height_m"):
        a, b = one[name], other[name]
        same &= a is None or b is None or abs(a - b) < SAME_SIZE * max(a, b)
    a, b = one["bearing_deg"], other["bearing_deg"]
    turn = 0.0 if a is None or b is None else abs(turn_deg(b, a))
    return bool(same and turn < FACING_DEG)


def level_metres(rows: Sequence[Row]) -> NDArray[np.float64]:
    """Level positions (n, 2), true to scale for what is near each other."""
    lon, lat = np.array([[r["lon_deg"], r["lat_deg"]] for r in rows], np.float64).T
    return np.stack([lon * np.cos(np.radians(lat)), lat], axis=1) * METRES_PER_DEGREE
