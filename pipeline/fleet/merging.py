"""The results of many drives into one inventory: panels, supports and sightings, cell by cell.

A cell is merged with a margin around it, in memory that grows with the panels of a cell and the number of cells, not
with the inventory. A support belongs to the first cell, by quadkey, that holds a sighting of it; sightings that are
taken do not come again in the cells beside.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import mercantile
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.fleet.folders import replaced_tables
from wayside.pipeline.fleet.inventory_data import (
    cell_origin,
    read_frames,
    read_signs,
    read_tiles,
    within,
)
from wayside.pipeline.fleet.merging_rows import Block, write_cell
from wayside.schemas.errors import UsageError
from wayside.schemas.settings.merging import MergeSettings
from wayside.schemas.sightings import MergedPanels, Sightings
from wayside.stages.inventory import (
    VECTOR_REACH_M,
    Agreement,
    Differences,
    agreement_of,
    measure_differences,
    merge_sightings,
    reference_vectors,
)

MARGIN_M = 300.0
"""Sightings so far outside a cell take part in its merging: longer than supports and gates."""
_MOST_LISTED = 20
_ROWS = 1 << 32
"""More than a drive has signs."""


@dataclass(slots=True)
class MergeReport:
    """What was merged: counts of rows, and of what could not be."""

    drives: int = 0
    panels: int = 0
    supports: int = 0
    sightings: int = 0
    cells: int = 0
    local_drives: list[str] = field(default_factory=list)
    """Drives without fixes or milepost, kept as they are."""
    left_out: int = 0
    """Their signs, and signs of other drives without a place on WGS 84."""
    vectors: list[str] = field(default_factory=list)
    """By which all panels of a drive differed from those of another, in words, a line each."""

    def __str__(self) -> str:
        """One line for a person, more where drives or signs could not be merged."""
        lines = [
            f"{counted(self.panels, 'panel')} on {counted(self.supports, 'support')}, by "
            f"{counted(self.sightings, 'sighting')} of {counted(self.drives, 'drive')}, "
            f"in {counted(self.cells, 'cell')}"
        ]
        if count := len(self.local_drives):
            some = ", ".join(self.local_drives[:5]) + (", ..." if count > 5 else "")
            lines.append(
                f"not merged, without satellite fixes or a milepost: {counted(count, 'drive')}: {some}"
            )
        if self.left_out:
            lines.append(f"in no merged table, without a place: {counted(self.left_out, 'sign')}")
        lines += self.vectors[:_MOST_LISTED]
        if (more := len(self.vectors) - _MOST_LISTED) > 0:
            lines.append(f"... and {more} more such drives")
        return "\n".join(lines)


def merge_inventory(
    results: Sequence[Path],
    out: Path,
    settings: MergeSettings | None = None,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> MergeReport:
    """Merge the results of drives and write `panels/`, `supports/` and `sightings/` of an inventory.

    They replace those of an earlier merging together. The same results and settings give the same bytes, in whatever
    order the results are given. Every part holds the settings in its metadata. `results`: folders of `wayside run`,
    each with its own name. `watch`: called with the number of cells done and to do. Raises UsageError where
    two results have one name, InputError where one is no result, and OutputError where the inventory cannot be written
    or hold files that no merging wrote.
    """
    folders = sorted(results, key=lambda folder: folder.name)
    for one, other in pairwise(folders):
        if one.name == other.name:
            raise UsageError(
                f"the results {one} and {other} have the same name. Rename one of the folders."
            )
    with replaced_tables(out) as part:
        return _Merging(folders, settings or MergeSettings()).write(part, watch)


class _Merging:
    """The drives by cell, and which of their sightings are taken."""

    def __init__(self, folders: Sequence[Path], settings: MergeSettings) -> None:
        self.settings, self.report, self._folders = settings, MergeReport(len(folders)), folders
        self._read = lru_cache(settings.drives_in_memory)(
            lambda number: read_signs(folders[number], read_frames(folders[number]), settings)
        )
        self._by_cell: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        self._taken: set[int] = set()
        for number, folder in enumerate(folders):
            tiles, left_out = read_tiles(folder, settings)
            self.report.left_out += left_out
            if left_out and not len(tiles):
                self.report.local_drives.append(folder.name)
            for x, y in np.unique(tiles, axis=0).tolist():
                self._by_cell[x, y].append(number)
        self._order = sorted(self._by_cell, key=self._name)
        self._vector_m = np.zeros((len(folders), 3))

    def _name(self, cell: tuple[int, int]) -> str:
        return str(mercantile.quadkey(*cell, self.settings.cell_zoom))

    def write(self, part: Path, watch: Callable[[int, int], None]) -> MergeReport:
        """Merge cell by cell into a folder."""
        self._find_vectors()
        report, total = self.report, len(self._order)
        for done, cell in enumerate(self._order):
            watch(done, total)
            block = self._block(cell, MARGIN_M)
            merged = merge_sightings(block.sightings, self.settings)
            own = self._own_supports(block, merged, cell)
            if own.any():
                counts = write_cell(part, self._name(cell), block, merged, own, self.settings)
                report.panels += counts[0]
                report.supports += counts[1]
                report.sightings += counts[2]
                report.cells += 1
        watch(total, total)
        return report

    def _find_vectors(self) -> None:
        """Measure by which vectors drives differ, over all cells, before anything is merged."""
        last = {n: place for place, cell in enumerate(self._order) for n in self._by_cell[cell]}
        first_ns = dict.fromkeys(last, np.iinfo(np.int64).max)
        waiting: defaultdict[tuple[int, int], list[Differences]] = defaultdict(list)
        found: dict[tuple[int, int], Agreement] = {}
        for place, cell in enumerate(self._order):
            block = self._block(cell, 2 * max(VECTOR_REACH_M))
            seen = block.sightings
            for number, time in zip(seen.drive.tolist(), seen.time_ns.tolist(), strict=True):
                first_ns[number] = min(first_ns[number], time)
            differ = measure_differences(seen, (block.cell == cell).all(axis=1))
            pairs, of = np.unique(differ.drive, axis=0, return_inverse=True)
            for k, (a, b) in enumerate(pairs.tolist()):
                waiting[a, b].append(differ.select(of.ravel() == k))
            for pair in [pair for pair in waiting if last[pair[0]] <= place]:
                agreement = agreement_of(Differences.joined(waiting.pop(pair)))
                if agreement is not None:
                    found[pair] = agreement
        names = [folder.name for folder in self._folders]
        for number, (reference, one) in sorted(reference_vectors(found, first_ns).items()):
            self._vector_m[number] = one.vector_m
            self.report.vectors.append(
                f"{names[number]}: all its panels differ from those of {names[reference]} by {one}; this is removed"
            )
        self.report.vectors += [
            f"{names[b]}: its panels may differ from those of {names[a]} by {one}, but these are rows of equal panels, "
            "which fit other offsets as well; nothing is removed"
            for (a, b), one in sorted(found.items())
            if not one.clear
        ]

    def _block(self, cell: tuple[int, int], margin_m: float) -> Block:
        """All sightings in a cell and a margin around it."""
        zoom, origin = self.settings.cell_zoom, cell_origin(*cell, self.settings.cell_zoom)
        around = {(cell[0] + dx, cell[1] + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
        drives, rows, parts, tiles = [], [], [], []
        for number in sorted({n for one in around for n in self._by_cell.get(one, ())}):
            drive = self._read(number)
            inside = np.flatnonzero(within(drive.geodetic, *cell, zoom, margin_m))
            if len(inside):
                drives.append(drive)
                rows.append(inside)
                tiles.append(drive.cell[inside])
                place = origin.topocentric(drive.geodetic[inside]) - self._vector_m[number]
                part = drive.sightings.select(inside)
                parts.append(replace(part, drive=np.full(len(inside), number), position=place))
        seen = Sightings.joined(parts)
        vector = self._vector_m[seen.drive]
        return Block(origin, tuple(drives), tuple(rows), seen, np.concatenate(tiles), vector)

    def _own_supports(
        self, block: Block, merged: MergedPanels, cell: tuple[int, int]
    ) -> NDArray[np.bool_]:
        """Which sightings (n,) are written with this cell; those that lie in cells to come are noted as taken."""
        key = block.sightings.drive * _ROWS + block.sightings.row
        tiles, of = np.unique(block.cell, axis=0, return_inverse=True)
        to_come = np.array([self._name((x, y)) >= self._name(cell) for x, y in tiles.tolist()])
        free = to_come[of.ravel()] & ~np.isin(key, list(self._taken))
        here = (block.cell == cell).all(axis=1)
        support = merged.support[merged.panel]
        own = free & np.isin(support, support[free & here])
        self._taken |= set(key[own & ~here].tolist())
        return np.asarray(own)
