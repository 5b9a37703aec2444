"""The results of many drives into one inventory: panels, supports and sightings, cell by cell.

A cell is merged with a margin around it, in memory that grows with the panels of a cell and the number of cells, not
with the inventory. A support belongs to the first cell, by quadkey, that holds a sighting of it; sightings that are
taken do not come again in the cells beside.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.fleet.folders import replaced_folders
from wayside.pipeline.fleet.inventory_data import (
    DriveSigns,
    cell_name,
    cell_origin,
    read_frames,
    read_signs,
    read_tiles,
    within,
)
from wayside.pipeline.fleet.merging_rows import Block, write_cell
from wayside.schemas.errors import UsageError
from wayside.schemas.inventory_tables import PANELS, SIGHTINGS, SUPPORTS
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

Ints = NDArray[np.int64]
_MOST_LISTED = 20
_ROWS = 1 << 32
"""More than a drive has signs."""
MERGED = (PANELS.name, SUPPORTS.name, SIGHTINGS.name)
"""Folders of an inventory that a merging writes."""


@dataclass(slots=True)
class MergeReport:
    """What was merged: counts of rows, and of what could not be.

    `local_drives`: drives without fixes, kept as they are. `left_out`: their signs, and signs of other drives without a
    place on WGS 84. `vectors`: by which all panels of a drive differed from those of another, in words, a line each.
    """

    drives: int = 0
    panels: int = 0
    supports: int = 0
    sightings: int = 0
    cells: int = 0
    local_drives: list[str] = field(default_factory=list)
    left_out: int = 0
    vectors: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        """One line for a person, more where drives or signs could not be merged."""
        words = (
            f"{self.panels} panels on {self.supports} supports, by {self.sightings} sightings of {self.drives} drives, "
            f"in {self.cells} cells"
        )
        if self.local_drives:
            some = ", ".join(self.local_drives[:5]) + (
                ", ..." if len(self.local_drives) > 5 else ""
            )
            count = len(self.local_drives)
            words += f"\n{count} drives have no satellite fixes and are kept as they are, unmerged: {some}"
        if self.left_out:
            words += f"\n{self.left_out} signs have no place on WGS 84 and are in no merged table"
        more = len(self.vectors) - _MOST_LISTED
        told = self.vectors[:_MOST_LISTED] + [f"... and {more} more such drives"] * (more > 0)
        return "\n".join([words, *told])


def merge_inventory(
    results: Sequence[Path],
    out: Path,
    settings: MergeSettings | None = None,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> MergeReport:
    """Merge the results of drives and write `panels/`, `supports/` and `sightings/` of an inventory.

    They replace those of an earlier merging together. The same results and settings give the same bytes, in whatever
    order the results are given. Every part holds the settings in its metadata.

    Parameters
    ----------
    results
        Folders that `wayside run` wrote, each with a name of its own.
    out
        Folder of the inventory, made where it is missing.
    settings
        Gates and error model; None: the defaults.
    watch
        Called with the number of cells done and to do.

    Raises
    ------
    UsageError
        Two results have one name.
    InputError
        One of them is no result, or damaged.
    OutputError
        The inventory cannot be written, or something stands there that no merging wrote.
    """
    chosen = MergeSettings() if settings is None else settings
    folders = sorted(results, key=lambda folder: folder.name)
    for one, other in pairwise(folders):
        if one.name == other.name:
            raise UsageError(
                f"the results {one} and {other} have the same name. Rename one of the folders."
            )
    with replaced_folders(out, MERGED) as part:
        return _Merging(folders, chosen).write(part, watch)


class _Merging:
    """The drives by cell, and which of their sightings are taken."""

    def __init__(self, folders: Sequence[Path], settings: MergeSettings) -> None:
        self.settings = settings
        self.report = MergeReport(len(folders))
        self._folders = folders
        self._read = lru_cache(settings.drives_in_memory)(self._read_drive)
        self._by_cell: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        self._taken: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        for number, folder in enumerate(folders):
            tiles, left_out = read_tiles(folder, settings)
            self.report.left_out += left_out
            if left_out and not len(tiles):
                self.report.local_drives.append(folder.name)
            for x, y in np.unique(tiles, axis=0).tolist():
                self._by_cell[x, y].append(number)
        zoom = settings.cell_zoom
        self._order = sorted(self._by_cell, key=lambda cell: cell_name(cell[0], cell[1], zoom))
        self._vector_m = np.zeros((len(folders), 3))

    def write(self, part: Path, watch: Callable[[int, int], None]) -> MergeReport:
        """Merge cell by cell into a folder."""
        self._find_vectors()
        zoom, total = self.settings.cell_zoom, len(self._order)
        for done, cell in enumerate(self._order):
            watch(done, total)
            block = self._block(cell, MARGIN_M)
            merged = merge_sightings(block.sightings, self.settings)
            own = self._own_supports(block, merged, cell)
            self._taken.pop(cell, None)
            if own.any():
                counts = write_cell(part, cell_name(*cell, zoom), block, merged, own, self.settings)
                self.report.panels += counts.panels
                self.report.supports += counts.supports
                self.report.sightings += counts.sightings
                self.report.cells += 1
        watch(total, total)
        return self.report

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
            here = (block.cell == cell).all(axis=1)
            differ = measure_differences(seen, here)
            pairs, of = np.unique(differ.drive, axis=0, return_inverse=True)
            for k, (a, b) in enumerate(pairs.tolist()):
                waiting[a, b].append(differ.select(of.ravel() == k))
            for pair in [pair for pair in waiting if last[pair[0]] <= place]:
                agreement = agreement_of(Differences.joined(waiting.pop(pair)))
                if agreement is not None:
                    found[pair] = agreement
        names = [folder.name for folder in self._folders]
        told = self.report.vectors
        for number, (reference, one) in sorted(reference_vectors(found, first_ns).items()):
            self._vector_m[number] = one.vector_m
            told.append(
                f"{names[number]}: all its panels differ from those of {names[reference]} by {one}; this is taken out"
            )
        told += [
            f"{names[b]}: its panels may differ from those of {names[a]} by {one}, but these are rows of equal panels, "
            "which fit other vectors as well; nothing is taken out"
            for (a, b), one in sorted(found.items())
            if not one.clear
        ]

    def _read_drive(self, number: int) -> DriveSigns:
        folder = self._folders[number]
        return read_signs(folder, read_frames(folder), self.settings)

    def _block(self, cell: tuple[int, int], margin_m: float) -> Block:
        """All sightings in a cell and a margin around it."""
        zoom, origin = self.settings.cell_zoom, cell_origin(*cell, self.settings.cell_zoom)
        around = {(cell[0] + dx, cell[1] + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
        numbers = sorted({n for one in around for n in self._by_cell.get(one, ())})
        drives, rows, parts, places = [], [], [], []
        for number in numbers:
            drive = self._read(number)
            inside = np.flatnonzero(within(drive.geodetic, *cell, zoom, margin_m))
            if len(inside):
                drives.append(drive)
                rows.append(inside)
                part = drive.sightings.select(inside)
                parts.append(replace(part, drive=np.full(len(inside), number)))
                places.append(origin.topocentric(drive.geodetic[inside]))
        sightings = Sightings.joined(parts)
        vector = self._vector_m[sightings.drive]
        placed = replace(sightings, position=np.concatenate(places) - vector)
        tiles = np.concatenate([d.cell[r] for d, r in zip(drives, rows, strict=True)])
        return Block(origin, tuple(drives), tuple(rows), placed, tiles, vector)

    def _own_supports(
        self, block: Block, merged: MergedPanels, cell: tuple[int, int]
    ) -> NDArray[np.bool_]:
        """Which sightings (n,) are written with this cell; those that lie in cells to come are noted as taken."""
        zoom, now = self.settings.cell_zoom, cell_name(*cell, self.settings.cell_zoom)
        key = block.sightings.drive * _ROWS + block.sightings.row
        free, here = np.zeros(len(key), bool), (block.cell == cell).all(axis=1)
        tiles, of = np.unique(block.cell, axis=0, return_inverse=True)
        of = of.ravel()
        for number, (x, y) in enumerate(tiles.tolist()):
            if cell_name(x, y, zoom) >= now:
                rows = of == number
                free[rows] = ~np.isin(key[rows], self._taken.get((x, y), []))
        support = merged.support[merged.panel]
        own = free & np.isin(support, support[free & here])
        for number, (x, y) in enumerate(tiles.tolist()):
            rows = own & ~here & (of == number)
            if rows.any():
                self._taken[x, y] += key[rows].tolist()
        return own
