"""What changed between two surveys of an inventory, cell by cell, written as `changes.parquet`."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import mercantile
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayside.pipeline.files.parquet import ParquetFile, geoparquet_metadata, record_batch
from wayside.pipeline.files.writing import refuse, whole_file
from wayside.pipeline.fleet.absence import Absence, Coverage, Side, coverage_of, mark_hidden
from wayside.pipeline.fleet.changes_rows import (
    PANEL_COLUMNS,
    Row,
    confidence_of,
    level_metres,
    places_of,
    row_of,
    same_face,
    successor,
)
from wayside.pipeline.fleet.folders import merged_parts, open_inventory, read_part
from wayside.pipeline.fleet.inventory_data import METRES_PER_DEGREE, cell_origin, cells, read_frames
from wayside.pipeline.fleet.manifest import DRIVES, Manifest
from wayside.pipeline.fleet.recorded_settings import merge_settings_of, schema_with_settings
from wayside.pipeline.fleet.surveys import Survey
from wayside.pipeline.fleet.visibility import read_view
from wayside.pipeline.results.result import RUN_FILE, read_rows
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.inventory_tables import CHANGES, CHANGES_OF_PANELS, PANELS, SIGHTINGS
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.schemas.tables import SIGNS
from wayside.stages.inventory import match_moved

_SIDES: tuple[Side, Side] = ("before", "after")
_SIGHTING = (
    "panel_id",
    "drive",
    "seen",
    "frame",
    "box",
    "confidence",
    "offset_east_m",
    "offset_north_m",
    "offset_up_m",
)


@dataclass(slots=True)
class ChangeReport:
    """Counts of `changes.parquet`, and of either survey its drives that tell less.

    `blind`: their results do not state what was in view. `unseen`: their logs give no images, with the reason, which
    leaves unknown what hid a place from them.
    """

    counts: Counter[str] = field(default_factory=Counter)
    drives: dict[str, int] = field(default_factory=dict)
    blind: list[str] = field(default_factory=list)
    unseen: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        """Lines for a person."""
        found = ", ".join(
            f"{self.counts[kind]} {kind.replace('_', ' ')}" for kind in CHANGES_OF_PANELS
        )
        words = f"{found}; by {self.drives['before']} drives before, {self.drives['after']} after"
        if self.blind:
            words += (
                f"\n{len(self.blind)} drives do not say what they had in view, as an earlier version or without fixes: "
                f"{', '.join(self.blind[:5])}; what only the others saw counts as not looked at"
            )
        if self.unseen:
            words += (
                f"\n{len(self.unseen)} drives have no images at hand: what stood in front of a place is not known of "
                f"them; the first: {self.unseen[0]}"
            )
        return words


def find_changes(
    inventory: Path,
    before: Survey,
    after: Survey,
    settings: ChangeSettings | None = None,
    *,
    overwrite: bool = False,
) -> ChangeReport:
    """Compare two surveys and write `changes.parquet` into the folder of the inventory.

    The settings of the comparison, and those that the inventory was merged with, are in the metadata of the file. A
    panel counts as gone, or as new, only where a drive of the other survey had its place in view. This takes enough
    images in which the panel would show whole, from the front, and as high as the lowest panels that this drive
    measures. Where the log exists, most of the images must also see past the place (`measure_occlusion`).

    Parameters
    ----------
    inventory
        Folder with `panels/`, `sightings/` and the results of the drives in `drives/`.
    before, after
        The surveys.
    settings
        When a place was in view, and when a panel has moved; None: the defaults.
    overwrite
        Replace whatever stands there as `changes.parquet`; else only an earlier comparison.

    Raises
    ------
    UsageError
        A survey has no drive, or the surveys overlap.
    InputError
        The folder is no inventory, its tables are not merged of its results as they are now, or one is damaged.
    OutputError
        The file cannot be written, or something else stands there.
    """
    manifest = open_inventory(inventory, by_fleet=False)
    if not (inventory / PANELS.name).is_dir():
        raise InputError(
            f"{inventory}: this is not an inventory, because it has no folder {PANELS.name}. `wayside fleet` merges "
            "drives."
        )
    if before.from_ns < after.until_ns and after.from_ns < before.until_ns:
        raise UsageError(f"the surveys {before.words} and {after.words} overlap")
    surveys: dict[Side, Survey] = {"before": before, "after": after}
    comparison = _Comparison(inventory, manifest, surveys, settings or ChangeSettings())
    target = inventory / CHANGES.file
    if target.exists() and not overwrite and not _is_own(target):
        raise refuse(target, "a file that is not a comparison of surveys")
    schema = schema_with_settings(CHANGES, merge=comparison.merge, changes=comparison.settings)
    with (
        whole_file(target, is_own=_is_own, overwrite=overwrite) as stream,
        ParquetFile(stream, schema, geoparquet_metadata([])) as sink,
    ):
        for rows in comparison.rows():
            if rows:
                columns = {n: [r.get(n) for r in rows] for n in CHANGES.schema.names}
                sink.write([record_batch(CHANGES, columns)])
    return comparison.report


class _Comparison:
    """The drives of both surveys, and what is gone or new until all cells are read."""

    def __init__(
        self,
        inventory: Path,
        manifest: Manifest,
        surveys: dict[Side, Survey],
        settings: ChangeSettings,
    ) -> None:
        self.settings = settings
        self.report = ChangeReport()
        self._inventory = inventory
        self._side: dict[str, Side] = {}
        self._time_ns: dict[str, int] = {}
        self._offset: dict[str, NDArray[np.float64]] = {}
        self._near: defaultdict[tuple[int, int], list[str]] = defaultdict(list)
        self._parts = merged_parts(inventory, PANELS.name)
        self.merge = merge_settings_of(self._parts[0]) if self._parts else MergeSettings()
        self._zoom = self.merge.cell_zoom
        self._view = lru_cache(self.merge.drives_in_memory)(
            lambda name: read_view(inventory / DRIVES / name)
        )
        for folder in _merged_results(inventory, manifest):
            self._index(folder, surveys)
        self.report.drives = {side: sum(s == side for s in self._side.values()) for side in _SIDES}
        for side, survey in surveys.items():
            if not self.report.drives[side]:
                raise UsageError(f"{inventory / DRIVES} holds no drive of {survey.words}")

    def rows(self) -> Iterator[list[Row]]:
        """Rows of the table, cell by cell, then those that are gone, new or moved."""
        absences: list[Absence] = []
        for part in self._parts:
            rows, alone = self._cell(part)
            absences += alone
            yield self._counted(rows)
        self.report.unseen = mark_hidden(self._inventory, absences, self._view, self.settings)
        for one in absences:
            one.settle(self.merge, self._frame)
        of_kind = {
            kind: [one.row for one in absences if one.row["change"] == kind]
            for kind in ("gone", "new", "not_looked_at")
        }
        yield self._counted(of_kind["not_looked_at"])
        yield self._counted(self._moved(of_kind["gone"], of_kind["new"]))

    def _frame(self, drive: str, row: int) -> int:
        view = self._view(drive)
        return -1 if view is None else int(view.frames.frame[row])

    def _counted(self, rows: list[Row]) -> list[Row]:
        self.report.counts.update(row["change"] for row in rows)
        return rows

    def _index(self, folder: Path, surveys: dict[Side, Survey]) -> None:
        """Note the survey of a drive and the cells it passes."""
        frames = read_frames(folder)
        if len(frames.frame):
            times = frames.time_ns
        else:
            signs = read_rows(folder, SIGNS, ("best_time_ns",))
            times = np.array([row["best_time_ns"] for row in signs], np.int64)
        side = next(
            (s for s, survey in surveys.items() if len(times) and int(times[0]) in survey), None
        )
        if side is None:
            return
        self._side[folder.name], self._time_ns[folder.name] = side, int(times[0])
        if self._view(folder.name) is None:
            self.report.blind.append(folder.name)
            return
        margin = (
            self.settings.farthest_m
            / METRES_PER_DEGREE
            / max(float(np.cos(np.radians(frames.geodetic[0, 1]))), 0.01)
        )
        around = [
            frames.geodetic + np.array([dx, dy, 0]) * margin
            for dx in (-1, 0, 1)
            for dy in (-1, 0, 1)
        ]
        for x, y in np.unique(cells(np.concatenate(around), self._zoom), axis=0).tolist():
            self._near[x, y].append(folder.name)

    def _cell(self, part: Path) -> tuple[list[Row], list[Absence]]:
        """One row for each panel, or pair of panels at a place, that both surveys saw; panels that one alone saw."""
        panels = {row["panel_id"]: row for row in read_part(part, PANEL_COLUMNS).to_pylist()}
        sightings = self._inventory / SIGHTINGS.name / part.parent.name / part.name
        seen: dict[str, dict[str, list[Row]]] = {side: defaultdict(list) for side in _SIDES}
        offsets: defaultdict[str, list[list[float]]] = defaultdict(list)
        for row in read_part(sightings, _SIGHTING).to_pylist():
            offsets[row["drive"]].append(
                [row[f"offset_{axis}_m"] for axis in ("east", "north", "up")]
            )
            side = self._side.get(row["drive"])
            if side is not None:
                seen[side][row["panel_id"]].append(row)
        rows: list[Row] = []
        alone: dict[str, list[str]] = {side: [] for side in _SIDES}
        joined: set[str] = set()
        for name in panels:
            if seen["before"][name]:
                later = name if seen["after"][name] else successor(name, panels, seen["after"])
                if later is None:
                    alone["before"].append(name)
                    continue
                joined |= {name, later}
                change = "unchanged" if later == name else "changed_face"
                rows.append(row_of(change, panels, seen, name, later))
        alone["after"] = [name for name in panels if seen["after"][name] and name not in joined]
        absences = [
            one
            for side in _SIDES
            for one in self._alone(side, alone[side], panels, seen, offsets, part)
        ]
        return rows, absences

    def _alone(
        self,
        side: Side,
        names: list[str],
        panels: dict[str, Row],
        seen: dict[str, dict[str, list[Row]]],
        offsets: dict[str, list[list[float]]],
        part: Path,
    ) -> list[Absence]:
        """Panels that one survey alone saw, with the drives that had their places in view."""
        if not names:
            return []
        tile = mercantile.quadkey_to_tile(part.parent.name.removeprefix("cell="))
        cell = int(tile.x), int(tile.y)
        origin = cell_origin(*cell, self._zoom)
        places = places_of([panels[n] for n in names])
        placed = replace(places, position=origin.topocentric(places.position))
        found = []
        for k, name in enumerate(names):
            pair = (name, None) if side == "before" else (None, name)
            row = row_of("not_looked_at", panels, seen, *pair)
            times = [self._time_ns[one["drive"]] for one in seen[side][name]]
            confidence = confidence_of(seen[side][name])
            where = places.position[k], places.size_m[k]
            found.append(Absence(row, side, confidence, times, *where))
        for drive in self._near.get(cell, ()):
            view = self._view(drive)
            if view is None:
                continue
            if drive in offsets:
                self._offset[drive] = np.mean(offsets[drive], axis=0)
            offset = self._offset.get(drive, np.zeros(3))  # of a cell before, where it saw none
            rows, shown = view.views(placed, origin, offset, self.settings)
            for name, one, coverage in zip(
                names, found, coverage_of(shown, rows, self.settings), strict=True
            ):
                if coverage is not None and all(s["drive"] != drive for s in seen[side][name]):
                    time = self._time_ns[drive]
                    one.coverages.append(
                        Coverage(drive, self._side[drive], time, *coverage, offset)
                    )
        return found

    def _moved(self, gone: list[Row], new: list[Row]) -> list[Row]:
        """The rows of what is gone and new, with one row where a panel was moved."""
        if not gone or not new:
            return gone + new
        where = level_metres([*gone, *new])
        near = cKDTree(where[: len(gone)]).query_ball_tree(
            cKDTree(where[len(gone) :]), self.settings.moved_m
        )
        pairs = [(g, n) for g, some in enumerate(near) for n in some if same_face(gone[g], new[n])]
        between = np.array(pairs, np.int64).reshape(-1, 2)
        away = np.linalg.norm(where[between[:, 0]] - where[len(gone) + between[:, 1]], axis=1)
        moved = match_moved(between, away)
        for g, n in between[moved].tolist():
            later = {k: v for k, v in new[n].items() if k.endswith("_after") or k in PANEL_COLUMNS}
            distance = float(np.linalg.norm(where[g] - where[len(gone) + n]))
            gone[g] |= later | {"change": "moved", "distance_m": distance, "probability": None}
        taken = set(between[moved][:, 1].tolist())
        return gone + [row for k, row in enumerate(new) if k not in taken]


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


def _is_own(path: Path) -> bool:
    """Whether a file is an earlier comparison."""
    try:
        return b'"changes"' in (pq.read_schema(path).metadata or {}).get(b"wayside", b"")
    except (OSError, ValueError):
        return False
