"""What changed between two surveys of an inventory, cell by cell, written as `changes.parquet`."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path

import mercantile
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayside.pipeline.code_words import code_of, statement_of
from wayside.pipeline.files.parquet import geoparquet_metadata, parquet_file, record_batch
from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.files.writing import require_free, whole_file
from wayside.pipeline.fleet.absence import (
    SIDES,
    Absence,
    Coverage,
    Row,
    Side,
    mark_hidden,
    read_view,
)
from wayside.pipeline.fleet.changes_review import ChangeReview
from wayside.pipeline.fleet.folders import (
    CELL,
    merge_settings_of,
    merged_parts,
    open_inventory,
    read_part,
    schema_with_settings,
)
from wayside.pipeline.fleet.inventory_data import METRES_PER_DEGREE, cell_origin, cells, read_frames
from wayside.pipeline.fleet.manifest import DRIVES, Manifest
from wayside.pipeline.fleet.straight_routes import with_place, without_place
from wayside.pipeline.results.result import RUN_FILE, holds_table, read_rows
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.inventory_tables import CHANGES, CHANGES_OF_PANELS, PANELS, SIGHTINGS
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.schemas.tables import SIGNS
from wayside.stages.geometry import turn_deg
from wayside.stages.inventory import FACING_DEG, PanelPlaces, match_moved

SAME_SIZE = 0.15
"""A panel that was moved keeps its width and height to this fraction: three standard deviations of two sizes."""
UNKNOWN_SIZE_M = 0.6
_PANEL = (
    "panel_id", "support_id", "replaces", "replaced_by", "status", "color", "shape", "lon_deg", "lat_deg", "alt_m",
    "bearing_deg", "panel_width_m", "panel_height_m", "route", "measure", "measure_unit", "geometry", "up_m",
    "lateral_m", "mutcd", "vienna", "category", "legend",
)  # fmt: skip
_SIGHTING = (
    "panel_id", "drive", "seen", "frame", "box", "confidence", "offset_east_m", "offset_north_m", "offset_up_m",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Survey:
    """Drives of a span of time, nanoseconds since 1970, the end not included; `words`: as it was asked for."""

    words: str
    from_ns: int
    until_ns: int

    def __contains__(self, time_ns: int) -> bool:
        """Whether a time lies in it."""
        return self.from_ns <= time_ns < self.until_ns


def parse_survey(text: str) -> Survey:
    """`2024`, `2024-05`, `2024-05-17`, or two of these with `..` between, the last one included; UTC.

    Raises UsageError for anything else, and where the end lies before the start.
    """
    first, _, last = text.partition("..")
    try:
        spans = [np.datetime64(day) for day in (first, last or first)]
        if not all(re.fullmatch(r"\d{4}(-\d\d){0,2}", day) for day in (first, last or first)):
            raise ValueError
    except ValueError as error:
        raise UsageError(
            f"{text} is not a survey. Write it as 2024, 2024-05, 2024-05-17 or 2024-03..2024-06."
        ) from error
    start, end = (int(t.astype("datetime64[s]").astype(int)) for t in (spans[0], spans[1] + 1))
    if end <= start:
        raise UsageError(f"the survey {text} ends before it starts")
    return Survey(text, start * 10**9, end * 10**9)


@dataclass(slots=True)
class ChangeReport:
    """Counts of `changes.parquet`, and of either survey its drives that tell less."""

    counts: Counter[str] = field(default_factory=Counter)
    drives: Counter[Side] = field(default_factory=Counter)
    blind: list[str] = field(default_factory=list)
    """Their results do not state what was in view."""
    unseen: list[str] = field(default_factory=list)
    """Their logs give no images, with the reason, which leaves unknown what hid a place from them."""
    review: ChangeReview = field(default_factory=ChangeReview)
    """What people said of changes."""

    def __str__(self) -> str:
        """Lines for a person."""
        found = ", ".join(
            f"{self.counts[kind]} {kind.replace('_', ' ')}" for kind in CHANGES_OF_PANELS
        )
        words = f"{found}; by {counted(self.drives['before'], 'drive')} before, {self.drives['after']} after"
        if self.blind:
            words += (
                f"\n{counted(len(self.blind), 'drive')} without a record of what was in view (from an earlier "
                f"version, or no fixes and milepost): {', '.join(self.blind[:5])}; panels that only other drives "
                "saw count as not looked at"
            )
        if self.unseen:
            words += (
                f"\n{counted(len(self.unseen), 'drive')} without images that can be read: what hid a place from "
                f"them is unknown; the first: {self.unseen[0]}"
            )
        return "\n".join(filter(None, (words, str(self.review))))


def find_changes(
    inventory: Path,
    before: Survey,
    after: Survey,
    settings: ChangeSettings | None = None,
    *,
    reviews: Sequence[Path] = (),
    overwrite: bool = False,
) -> ChangeReport:
    """Compare two surveys and write `changes.parquet` into the folder of the inventory, with what people said of it.

    The settings of the comparison, and those that the inventory was merged with, are in the metadata of the file. A
    panel counts as gone, or as new, only where a drive of the other survey had its place in view. This takes enough
    images in which the panel would show whole, from the front, and as high as the lowest panels that this drive
    measures. Where the log exists, most of the images must also see past the place (`measure_occlusion`).

    `reviews`: files that the page of changes saved; none: those in the folder. `overwrite`: replace any file, not only
    an earlier comparison. Raises UsageError if a survey has no drive, or they overlap. Raises InputError if the folder
    is no inventory, is damaged, or has results that are not merged, or a file is no review. Raises OutputError if a
    file cannot be written.
    """
    manifest = open_inventory(inventory, by_fleet=False)
    if not (inventory / PANELS.name).is_dir():
        raise InputError(
            f"{inventory}: this is not an inventory, because it has no folder {PANELS.name}. `wayside fleet` merges "
            "drives."
        )
    if before.from_ns < after.until_ns and after.from_ns < before.until_ns:
        raise UsageError(f"the surveys {before.words} and {after.words} overlap")
    target = inventory / CHANGES.file
    is_own = partial(holds_table, table=CHANGES)
    require_free(target, is_own=is_own, overwrite=overwrite)
    surveys: dict[Side, Survey] = {"before": before, "after": after}
    comparison = _Comparison(inventory, manifest, surveys, settings or ChangeSettings())
    review = comparison.report.review
    review.read(inventory, reviews)
    schema = schema_with_settings(CHANGES, merge=comparison.merge, changes=comparison.settings)
    with (
        whole_file(target, is_own=is_own, overwrite=overwrite) as stream,
        parquet_file(stream, schema, geoparquet_metadata([])) as sink,
    ):
        for rows in comparison.rows():
            comparison.report.counts.update(row["change"] for row in rows)
            if rows:
                told = [without_place(row) | review.columns(row) for row in rows]
                columns = {n: [r.get(n) for r in told] for n in CHANGES.schema.names}
                sink.write_batch(record_batch(CHANGES, columns))
    return comparison.report


class _Cell:
    """The panels of a cell by name, and the sightings of each in both surveys."""

    def __init__(self, inventory: Path, part: Path, side_of: dict[str, Side]) -> None:
        sightings = inventory / SIGHTINGS.name / part.parent.name / part.name
        self.panels: dict[str, Row] = {
            row["panel_id"]: with_place(row) for row in read_part(part, _PANEL).to_pylist()
        }
        self.seen: dict[Side, dict[str, list[Row]]] = {side: defaultdict(list) for side in SIDES}
        offsets = defaultdict(list)
        for row in read_part(sightings, _SIGHTING).to_pylist():
            offsets[row["drive"]].append([row[name] for name in _SIGHTING[-3:]])
            if row["drive"] in side_of:
                self.seen[side_of[row["drive"]]][row["panel_id"]].append(row)
        self.offset = {drive: np.mean(some, axis=0) for drive, some in offsets.items()}
        tile = mercantile.quadkey_to_tile(part.parent.name.removeprefix(CELL))
        self.tile = int(tile.x), int(tile.y)

    def paired(self) -> tuple[list[Row], dict[Side, list[str]]]:
        """A row for each panel, or pair at a place, that both surveys saw, and the panels that one alone saw."""
        rows, joined = [], set()
        alone: dict[Side, list[str]] = {"before": [], "after": []}
        for name in (name for name in self.panels if self.seen["before"][name]):
            later: str | None = name
            while later in self.panels and not self.seen["after"][later]:
                later = self.panels[later]["replaced_by"]
            if later not in self.panels:
                alone["before"].append(name)
                continue
            joined |= {name, later}
            change = "unchanged" if later == name else "changed_face"
            rows.append(self.row(change, {"before": name, "after": later}))
        alone["after"] = [n for n in self.panels if self.seen["after"][n] and n not in joined]
        return rows, alone

    def row(self, change: str, names: dict[Side, str]) -> Row:
        """A row with the last image of each survey, without what only the other survey's images say."""
        row: Row = {"change": change}
        for side in SIDES:
            name = names.get(side)
            seen = self.seen[side][name] if name is not None else []
            drives = len({one["drive"] for one in seen})
            row |= {f"panel_{side}": name, f"hidden_{side}": 0}
            row |= {f"drives_{side}": drives, f"seen_{side}": drives}
            if name is not None:
                row |= self.panels[name]
                row |= {f"{k}_{side}": self.panels[name][k] for k in ("color", "shape")}
                row[f"code_{side}"] = code_of(self.panels[name])
                last = max(seen, key=lambda one: (one["seen"], one["drive"]))
                row |= {f"{k}_{side}": last[k] for k in ("drive", "frame", "box")}
                row[f"date_{side}"] = last["seen"]
        return row

    def places(self, names: Sequence[str]) -> PanelPlaces:
        """Where panels are; `position` is longitude, latitude and height."""
        numbers = np.array([[self.panels[n][k] for k in _PANEL[7:13]] for n in names], np.float64)
        size = np.where(np.isfinite(numbers[:, 4:]), numbers[:, 4:], UNKNOWN_SIZE_M)
        return PanelPlaces(numbers[:, :3], np.radians(numbers[:, 3]), size)


class _Comparison:
    """The drives of both surveys, and what is gone or new until all cells are read."""

    def __init__(
        self,
        inventory: Path,
        manifest: Manifest,
        surveys: dict[Side, Survey],
        settings: ChangeSettings,
    ) -> None:
        self.settings, self.report, self._inventory = settings, ChangeReport(), inventory
        self._side: dict[str, Side] = {}
        self._time_ns: dict[str, int] = {}
        self._offset: dict[str, NDArray[np.float64]] = {}
        self._near: defaultdict[tuple[int, int], list[str]] = defaultdict(list)
        self._parts = merged_parts(inventory, PANELS.name)
        self.merge = merge_settings_of(self._parts[0]) if self._parts else MergeSettings()
        self._view = lru_cache(self.merge.drives_in_memory)(
            lambda name: read_view(inventory / DRIVES / name)
        )
        for folder in _merged_results(inventory, manifest):
            self._index(folder, surveys)
        self.report.drives = Counter(self._side.values())
        for side, survey in surveys.items():
            if not self.report.drives[side]:
                raise UsageError(f"{inventory / DRIVES} holds no drive of {survey.words}")

    def rows(self) -> Iterator[list[Row]]:
        """Rows of the table, cell by cell, then those that are gone, new or moved."""
        absences: list[Absence] = []
        for part in self._parts:
            cell = _Cell(self._inventory, part, self._side)
            rows, alone = cell.paired()
            for side in SIDES:
                absences += self._alone(cell, side, alone[side])
            yield rows
        self.report.unseen = mark_hidden(self._inventory, absences, self._view, self.settings)
        settled = [one.settled(self.merge, self._view) for one in absences]
        yield [row for row in settled if row["change"] == "not_looked_at"]
        yield self._moved(
            *([row for row in settled if row["change"] == k] for k in ("gone", "new"))
        )

    def _index(self, folder: Path, surveys: dict[Side, Survey]) -> None:
        """Note the survey of a drive and the cells it passes."""
        frames = read_frames(folder)
        times = frames.time_ns.tolist()
        if not times:
            times = [row["best_time_ns"] for row in read_rows(folder, SIGNS, ("best_time_ns",))]
        side = next((s for s, survey in surveys.items() if times and times[0] in survey), None)
        if side is None:
            return
        self._side[folder.name], self._time_ns[folder.name] = side, times[0]
        if self._view(folder.name) is None:
            self.report.blind.append(folder.name)
            return
        scale = METRES_PER_DEGREE * max(float(np.cos(np.radians(frames.geodetic[0, 1]))), 0.01)
        margin = self.settings.farthest_m / scale
        sides = [np.array([x, y, 0]) * margin for x in (-1, 0, 1) for y in (-1, 0, 1)]
        around = np.concatenate([frames.geodetic + side for side in sides])
        for x, y in np.unique(cells(around, self.merge.cell_zoom), axis=0).tolist():
            self._near[x, y].append(folder.name)

    def _alone(self, cell: _Cell, side: Side, names: list[str]) -> list[Absence]:
        """Panels that one survey alone saw, with the drives that had their places in view."""
        if not names:
            return []
        origin = cell_origin(*cell.tile, self.merge.cell_zoom)
        places = cell.places(names)
        level = replace(places, position=origin.topocentric(places.position))
        found = [
            Absence(
                cell.row("not_looked_at", {side: name}),
                side,
                [self._time_ns[one["drive"]] for one in cell.seen[side][name]],
                [one["confidence"] for one in cell.seen[side][name]],
                places.position[k],
                places.size_m[k],
            )
            for k, name in enumerate(names)
        ]
        for drive in self._near.get(cell.tile, ()):
            view = self._view(drive)
            if view is None:
                continue
            self._offset |= {drive: cell.offset[drive]} if drive in cell.offset else {}
            offset = self._offset.get(drive, np.zeros(3))  # of a cell before, where it saw none
            about = drive, self._side[drive], self._time_ns[drive], offset
            for k, images in enumerate(view.coverages(level, origin, offset, self.settings)):
                saw = any(one["drive"] == drive for one in cell.seen[side][names[k]])
                if images is not None and not saw:
                    found[k].coverages.append(Coverage(*about, *images))
        return found

    def _moved(self, gone: list[Row], new: list[Row]) -> list[Row]:
        """The rows of what is gone and new, with one row where a panel was moved."""
        if not gone or not new:
            return gone + new
        lon, lat = np.array([[r["lon_deg"], r["lat_deg"]] for r in (*gone, *new)], np.float64).T
        where = np.stack([lon * np.cos(np.radians(lat)), lat], axis=1) * METRES_PER_DEGREE
        ours, theirs = where[: len(gone)], where[len(gone) :]
        near = cKDTree(ours).query_ball_tree(cKDTree(theirs), self.settings.moved_m)
        pairs = [(g, n) for g, some in enumerate(near) for n in some if same_face(gone[g], new[n])]
        between = np.array(pairs, np.int64).reshape(-1, 2)
        away = np.linalg.norm(ours[between[:, 0]] - theirs[between[:, 1]], axis=1)
        moved = match_moved(between, away)
        for (g, n), distance in zip(between[moved].tolist(), away[moved].tolist(), strict=True):
            later = {k: v for k, v in new[n].items() if k.endswith("_after") or k in _PANEL}
            gone[g] |= later | {"change": "moved", "distance_m": distance, "probability": None}
        taken = set(between[moved][:, 1].tolist())
        return gone + [row for k, row in enumerate(new) if k not in taken]


def same_face(one: Row, other: Row) -> bool:
    """Whether two panels look alike: colour, shape, code, size and facing; what is unknown of either tells nothing."""

    def both(name: str) -> bool:
        return one[name] is not None and other[name] is not None

    looks = all(one[name] == other[name] for name in ("color", "shape") if both(name))
    ours, theirs = statement_of(one), statement_of(other)
    looks &= ours[: len(theirs)] == theirs[: len(ours)]
    sizes = [(one[n], other[n]) for n in ("panel_width_m", "panel_height_m") if both(n)]
    turn = turn_deg(other["bearing_deg"], one["bearing_deg"]) if both("bearing_deg") else 0.0
    alike = all(abs(a - b) < SAME_SIZE * max(a, b) for a, b in sizes)
    return bool(looks and alike and abs(turn) < FACING_DEG)


def _merged_results(inventory: Path, manifest: Manifest) -> list[Path]:
    """Folders of the results that the merged tables were made of; raises InputError where they are of others.

    A drive that is not merged would count as one that looked everywhere and saw nothing.
    """
    if not manifest.logs:  # merged without a fleet
        return sorted(path.parent for path in (inventory / DRIVES).glob(f"*/{RUN_FILE}"))
    if manifest.merged != manifest.results():
        raise InputError(
            f"{inventory}: some results are newer than the merged tables. A fleet is running, or ended before it "
            "merged. Let `wayside fleet` finish, and compare then."
        )
    return [inventory / DRIVES / entry.name for entry in manifest.done()]
