"""A page of the changes between two surveys: the images of both side by side."""

from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wayside.pipeline import pages
from wayside.pipeline.evidence.crops import crop_addresses
from wayside.pipeline.evidence.gather import DriveMap, Globe
from wayside.pipeline.evidence.maps import overview
from wayside.pipeline.evidence.marks import METRIC, Units, appearance_of, class_words, route_words
from wayside.pipeline.files.parquet import read_parquet
from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.fleet.absence import SIDES, Row
from wayside.pipeline.fleet.inventory_data import METRES_PER_DEGREE
from wayside.pipeline.fleet.manifest import DRIVES
from wayside.schemas.errors import InputError
from wayside.schemas.inventory_tables import CHANGES, CHANGES_OF_PANELS
from wayside.schemas.labels import Box

QUIET = ("unchanged", "not_looked_at")
"""Changes that a page shows only where all are asked for, or where something hides the place."""
_KINDS = list(CHANGES_OF_PANELS)
INKS = dict(zip(_KINDS, "#969ca4 #1f6fd0 #f08c1e #28a050 #d03030 #d6dbe1".split(), strict=True))
"""Of the dots on the map."""
REVIEWED = (
    "change panel_before panel_after code_before code_after lon_deg lat_deg route measure".split()
)
"""Columns that a saved review repeats."""
_SIZE = 480, 360
_MARK = "wayside changes"


@dataclass(frozen=True, slots=True)
class Page:
    """What a page shows: how many changes, how many images no log holds, and why."""

    shown: int
    lost_images: int
    faults: tuple[str, ...]


def write_page(
    inventory: Path,
    file: Path,
    names: tuple[str, str],
    *,
    every: bool = False,
    units: Units = METRIC,
    overwrite: bool = False,
) -> Page:
    """Write `changes.parquet` of an inventory as a page, with images from the logs of its drives.

    `names`: of the surveys before and after. `every`: also show unchanged panels, and panels that were out of view
    without being hidden. `units`: of lengths. `overwrite`: replace any file; else only such a page. Raises InputError
    for a missing or damaged comparison, and OutputError.
    """
    table = inventory / CHANGES.file
    if not table.is_file():
        raise InputError(f"{inventory}: there is no {CHANGES.file}. Compare two surveys first.")
    everything: list[Row] = read_parquet(table).drop_columns(["geometry"]).to_pylist()
    rows = [
        row
        for row in everything
        if every or row["change"] not in QUIET or row["hidden_before"] or row["hidden_after"]
    ]
    rows.sort(key=_order)
    kinds = [row["change"] for row in rows]
    images, faults = _images(inventory, rows)
    counts = Counter(row["change"] for row in everything)
    told = [{name: row.get(name) for name in REVIEWED} for row in rows]
    said = [
        one | {"review": row["review"], "reviewer": row["reviewer"], "note": row["review_note"]}
        for one, row in zip(told, rows, strict=True)
        if row.get("review")
    ]
    placed = [k for k, row in enumerate(rows) if row["lon_deg"] is not None]
    figures = [
        [_figure(row, side, images.get((k, side))) for side in SIDES] for k, row in enumerate(rows)
    ]
    drawn, about = overview(_places([rows[k] for k in placed]), units) or (None, {})
    page = pages.render_page(
        "changes.html",
        _MARK,
        names=names,
        units=units,
        map=drawn,
        dots=[
            (f"change-{k}", f"{class_words(kinds[k])}: {_heading(rows[k])}", INKS[kinds[k]])
            for k in placed
        ],
        inks=INKS,
        about={"map": about, "names": names, "rows": told, "reviews": said},
        counts={kind: counts[kind] for kind in _KINDS},
        shown=[kind for kind in _KINDS if kind in kinds],
        cards=[*zip(rows, map(_heading, rows), map(route_words, rows), figures, strict=True)],
    )
    pages.write_page(file, page, _MARK, overwrite=overwrite)
    wanted = sum(row[f"drive_{side}"] is not None for row in rows for side in SIDES)
    return Page(len(rows), wanted - len(images), tuple(faults))


def _places(rows: list[Row]) -> DriveMap:
    """The panels on a plane about the first of them."""
    places = np.array([[row["lon_deg"], row["lat_deg"], 0.0] for row in rows]).reshape(-1, 3)
    origin = places[0] if len(places) else np.zeros(3)
    globe = Globe(np.eye(2), float(origin[0]), float(origin[1]), 1 / METRES_PER_DEGREE)
    steps = np.array([globe.lon_deg_per_m, globe.lat_deg_per_m, 1.0])
    return DriveMap({}, np.zeros((0, 3)), (places - origin) / steps, {}, globe=globe)


def _heading(row: Row) -> str:
    """The codes of a panel, one where it has not changed; its name where none is known."""
    codes = dict.fromkeys(filter(None, (row.get(f"code_{side}") for side in SIDES)))
    return " → ".join(codes) or str(row["panel_before"] or row["panel_after"])


def _order(row: Row) -> tuple[bool, int, float, str, str]:
    """What has changed before what has not; by kind of change, the surest first."""
    names, kind = (row["panel_before"] or "", row["panel_after"] or ""), row["change"]
    return kind in QUIET, _KINDS.index(kind), -(row["probability"] or 0.0), *names


def _images(inventory: Path, rows: list[Row]) -> tuple[dict[tuple[int, str], str], list[str]]:
    """Addresses of WebP images by row and side; faults of the logs that give none, in words."""
    wanted: defaultdict[str, list[tuple[tuple[int, str], int, Box]]] = defaultdict(list)
    for number, row in enumerate(rows):
        for side in SIDES:
            if row[f"drive_{side}"] is not None:
                box = tuple(row[f"box_{side}"])
                wanted[row[f"drive_{side}"]].append(((number, side), row[f"frame_{side}"], box))
    images: dict[tuple[int, str], str] = {}
    faults: list[str] = []
    for drive, boxes in sorted(wanted.items()):
        found, fault = crop_addresses(inventory / DRIVES / drive, None, boxes, _SIZE)
        images |= found
        faults += [fault] * bool(fault)
    return images, faults


def _figure(row: Row, side: str, source: str | None) -> dict[str, Any]:
    """The image of one survey; where nothing was seen, the place."""
    of = {name: row[f"{name}_{side}"] for name in ("seen", "drives", "hidden", "drive", "frame")}
    face, by = "not looked at", "not in view of any drive"
    if of["hidden"]:
        by = f"hidden from {counted(of['hidden'], 'drive')}"
    if of["drives"]:
        appearance = appearance_of(row[f"color_{side}"], row[f"shape_{side}"])
        named = " ".join(filter(None, (row.get(f"code_{side}"), appearance)))
        face = named if of["seen"] else "no panel found"
        both = row["change"] in ("unchanged", "changed_face")
        by = f"{of['seen']} of {counted(of['drives'], 'drive')}"
        by = counted(of["seen"], "drive") if both else by
        hidden = f", hidden from {of['hidden']}" if of["hidden"] else ""
        by = f"seen by {by}{hidden}"
    if of["drive"] is not None:
        by += f", {of['drive']} frame {of['frame']}"
    return {"face": face, "words": f"{face}; {by}", "source": source}
