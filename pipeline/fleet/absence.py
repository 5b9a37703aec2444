"""What one survey saw and the other did not: whether drives of either had its place in view and saw past it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.crops import read_images
from wayside.pipeline.fleet.changes_rows import Row
from wayside.pipeline.fleet.manifest import DRIVES
from wayside.pipeline.fleet.visibility import DriveView
from wayside.pipeline.reading.frames import ReadReport
from wayside.pipeline.results.result import find_log, read_rows, read_run, read_settings
from wayside.schemas.errors import InputError
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.schemas.tables import FRAMES
from wayside.stages.inventory import YEAR_NS, PanelViews, gone_probability, measure_occlusion

VIEWS = 3
"""A place was in view if a panel there would show in so many images, one more than make a landmark."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Side = Literal["before", "after"]
_OTHER: dict[Side, Side] = {"before": "after", "after": "before"}


@dataclass(slots=True)
class Coverage:
    """A drive that had a place in view and did not see the panel.

    `rows`: of its frames, in order, that show the place largest. `best`: row of the largest, box (4,) there. `offset_m`
    (3,): error of the drive there. `time_ns`: of the drive. `hidden`: something nearer stands before the place.
    """

    drive: str
    side: Side
    time_ns: int
    rows: Ints
    best: int
    box: Floats
    offset_m: Floats
    hidden: bool = False


@dataclass(slots=True)
class Absence:
    """A panel that one survey saw and the other did not, and the drives that had its place in view.

    `row`: of the table, so far `not_looked_at`. `side`: the survey that saw it, with this confidence, at times_ns.
    `place` (3,): longitude, latitude, height. `size_m` (2,).
    """

    row: Row
    side: Side
    confidence: float
    times_ns: Sequence[int]
    place: Floats
    size_m: Floats
    coverages: list[Coverage] = field(default_factory=list)

    def settle(self, settings: MergeSettings, frame_of: Callable[[str, int], int]) -> None:
        """Fill the row from the coverages: gone or new where a drive of the other survey saw past the place."""
        row, other = self.row, _OTHER[self.side]
        for coverage in self.coverages:
            row[f"{'hidden' if coverage.hidden else 'drives'}_{coverage.side}"] += 1
        coverages = [coverage for coverage in self.coverages if coverage.side == other]
        clear = [coverage for coverage in coverages if not coverage.hidden]
        if coverages:
            shown = max(
                clear or coverages, key=lambda coverage: float(coverage.box[3] - coverage.box[1])
            )
            frame = frame_of(shown.drive, shown.best)
            row |= {f"drive_{other}": shown.drive, f"frame_{other}": frame}
            row[f"box_{other}"] = shown.box.tolist()
        if not clear:
            return
        row["change"] = "gone" if self.side == "before" else "new"
        between = min(abs(coverage.time_ns - time) for coverage in clear for time in self.times_ns)
        misses = row[f"drives_{self.side}"] - row[f"seen_{self.side}"]
        row["probability"] = float(
            gone_probability(
                np.array([self.confidence]),
                np.array([between / YEAR_NS]),
                np.array([len(clear)]),
                np.array([misses]),
                settings,
            )[0]
        )


def coverage_of(
    found: PanelViews, rows: Ints, settings: ChangeSettings
) -> list[tuple[Ints, int, Floats] | None]:
    """For each place the rows of the frames that show it largest, the best of them, and the box there."""
    coverages: list[tuple[Ints, int, Floats] | None] = []
    for height, box in zip(found.height, found.box, strict=True):
        largest = np.argsort(-height, kind="stable")[: settings.images]
        largest = largest[height[largest] > 0]
        if np.count_nonzero(height) < VIEWS:
            coverages.append(None)
        else:
            coverages.append((rows[np.sort(largest)], int(rows[largest[0]]), box[largest[0]]))
    return coverages


def mark_hidden(
    inventory: Path,
    absences: Sequence[Absence],
    view_of: Callable[[str], DriveView | None],
    settings: ChangeSettings,
) -> list[str]:
    """Mark where images show something nearer than the place; drives whose log gives no images, in words."""
    of_drive: defaultdict[str, list[tuple[Absence, Coverage]]] = defaultdict(list)
    for absence in absences:
        for coverage in absence.coverages:
            of_drive[coverage.drive].append((absence, coverage))
    faults = []
    for drive, coverages in sorted(of_drive.items()):
        view = view_of(drive)
        if view is None:
            continue
        try:
            _mark_hidden_of_drive(inventory / DRIVES / drive, view, coverages, settings)
        except InputError as error:
            faults.append(f"{drive}: {error}")
    return faults


def _mark_hidden_of_drive(
    folder: Path,
    view: DriveView,
    coverages: Sequence[tuple[Absence, Coverage]],
    settings: ChangeSettings,
) -> None:
    """Read the images of one drive once, each kept as long as a coverage needs it."""
    waiting = sorted(coverages, key=lambda one: int(one[1].rows[-1]))
    row_of = {
        int(view.frames.frame[row]): int(row) for _, coverage in coverages for row in coverage.rows
    }
    run = read_run(folder)
    times = {
        row["frame"]: row["log_time_ns"]
        for row in read_rows(folder, FRAMES, ("frame", "log_time_ns"))
    }
    log, read = find_log(run, None), read_settings(folder, run)
    kept: dict[int, NDArray[np.uint8]] = {}
    for image in read_images(log, read, row_of.keys(), times, ReadReport()):
        row = row_of[image.frame.index]
        if image.grey is not None:
            kept[row] = image.grey
        done = 0
        for absence, coverage in waiting:
            if coverage.rows[-1] > row:
                break
            rows = np.array([r for r in coverage.rows.tolist() if r in kept], np.int64)
            grey = [kept[r] for r in rows.tolist()]
            images = view.place_images(absence.place, coverage.offset_m, rows, grey)
            width, height = absence.size_m.tolist()
            past, hidden = measure_occlusion(images, view.camera, (width, height), settings)
            coverage.hidden = hidden > 0 and hidden >= past
            done += 1
        del waiting[:done]
        first = min((int(coverage.rows[0]) for _, coverage in waiting), default=row + 1)
        for old in [r for r in kept if r < first]:
            del kept[old]
    if waiting:
        last = int(view.frames.frame[waiting[-1][1].rows[-1]])
        raise InputError(
            f"{log}: the log ends before image {last}: it is shorter than it was at the run"
        )
