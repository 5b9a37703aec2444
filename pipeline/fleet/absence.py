"""What one survey saw and the other did not: whether drives of either had its place in view and saw past it."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.crops import read_images
from wayside.pipeline.files.parsing import CONTENT_FAULTS
from wayside.pipeline.fleet.inventory_data import DriveFrames, Floats, Ints, read_frames, read_signs
from wayside.pipeline.fleet.manifest import DRIVES
from wayside.pipeline.results.result import read_run
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.stages.georeference import LocalOrigin
from wayside.stages.inventory import (
    YEAR_NS,
    PanelPlaces,
    PlaceImage,
    gone_probability,
    measure_occlusion,
    views_of,
)

VIEWS = 3
"""A place was in view if a panel there would show in so many images, one more than make a landmark."""
SEEN_SHARE = 0.75
"""Share of a drive's panels first measured at the visible height, or less: its own detection range."""
FEWEST_SIGNS = 5
"""A drive with fewer panels takes `VISIBLE_PX` (estimate)."""
VISIBLE_PX = 25.0
"""Height of a visible face, where the drive does not tell: nearly all of it are found on rendered drives."""

Row = dict[str, Any]
Side = Literal["before", "after"]
SIDES: tuple[Side, Side] = ("before", "after")


@dataclass(frozen=True, slots=True)
class DriveView:
    """A drive that can say what it had in view."""

    name: str
    """Folder of the result."""
    frames: DriveFrames
    camera: Camera
    smallest_px: float
    """Height of a face from which on it measures them."""

    def coverages(
        self, places: PanelPlaces, origin: LocalOrigin, offset_m: Floats, settings: ChangeSettings
    ) -> list[tuple[Ints, int, Floats] | None]:
        """For each place about an origin the rows of the frames that show it largest, the best of them, the box there.

        None: it was not in view. `offset_m` (3,): error of the drive's positions there.
        """
        centre = self.centres(origin, offset_m, slice(None))
        low, high = places.position[:, :2].min(axis=0), places.position[:, :2].max(axis=0)
        low, high = low - settings.farthest_m, high + settings.farthest_m
        rows = np.flatnonzero(((centre[:, :2] > low) & (centre[:, :2] < high)).all(axis=1))
        turned = self.frames.rotation[rows]
        shown = views_of(places, centre[rows], turned, self.camera, self.smallest_px)
        told: list[tuple[Ints, int, Floats] | None] = []
        for height, box in zip(*shown, strict=True):
            largest = np.argsort(-height, kind="stable")[: settings.images]
            largest = largest[height[largest] > 0]
            if np.count_nonzero(height) < VIEWS:
                told.append(None)
            else:
                told.append((rows[np.sort(largest)], int(rows[largest[0]]), box[largest[0]]))
        return told

    def centres(self, origin: LocalOrigin, offset_m: Floats, rows: Ints | slice) -> Floats:
        """Positions of its cameras about an origin, (k, 3)."""
        return np.asarray(origin.topocentric(self.frames.geodetic[rows]) - offset_m, np.float64)


def read_view(folder: Path) -> DriveView | None:
    """The cameras of a drive; None where its result does not hold their places, headings and calibration.

    Raises InputError where the folder is no result, or damaged.
    """
    frames, about = read_frames(folder), read_run(folder).get("camera")
    if about is None or not len(frames.frame):
        return None
    try:
        camera = Camera(**(about | {"distortion": tuple(about["distortion"])}))
    except CONTENT_FAULTS as error:
        raise InputError(
            f"{folder}: the calibration in run.json cannot be used: {error}. Run the log again."
        ) from error
    return DriveView(folder.name, frames, camera, _smallest_px(folder, frames, camera))


def _smallest_px(folder: Path, frames: DriveFrames, camera: Camera) -> float:
    """Height of face from which on the drive measured most of its panels."""
    signs = read_signs(folder, frames, MergeSettings())
    if len(signs.table) < FEWEST_SIGNS:
        return VISIBLE_PX
    origin = LocalOrigin(float(frames.geodetic[0, 1]), float(frames.geodetic[0, 0]), 0.0)
    at = np.searchsorted(frames.frame, signs.table["first_frame"].to_numpy())
    at = np.minimum(at, len(frames.frame) - 1)
    away = origin.topocentric(signs.geodetic) - origin.topocentric(frames.geodetic)[at]
    height = camera.fy * signs.sightings.size_m[:, 1] / np.linalg.norm(away, axis=1)
    return float(np.nanquantile(height, SEEN_SHARE))


@dataclass(slots=True)
class Coverage:
    """A drive that had a place in view and did not see the panel."""

    drive: str
    side: Side
    time_ns: int
    offset_m: Floats
    """Error of the drive there, (3,)."""
    rows: Ints
    """Of its frames, in order, that show the place largest."""
    best: int
    """Row of the largest."""
    box: Floats
    """The place in that, (4,)."""
    hidden: bool = False
    """Something nearer stands before the place."""


@dataclass(slots=True)
class Absence:
    """A panel that one survey saw and the other did not, and the drives that had its place in view."""

    row: Row
    """Of the table, so far `not_looked_at`."""
    side: Side
    """The survey that saw it."""
    times_ns: Sequence[int]
    """Of the drives that saw it."""
    confidences: Sequence[float | None]
    """Of their sightings; the presets of the report state none."""
    place: Floats
    """Longitude, latitude, height, (3,)."""
    size_m: Floats
    """Width and height, (2,)."""
    coverages: list[Coverage] = field(default_factory=list)

    def settled(self, settings: MergeSettings, view_of: Callable[[str], DriveView | None]) -> Row:
        """The row, filled from the coverages: gone or new where a drive of the other survey saw past the place."""
        row, other = self.row, SIDES[self.side == "before"]
        for one in self.coverages:
            row[f"{'hidden' if one.hidden else 'drives'}_{one.side}"] += 1
        looked = [one for one in self.coverages if one.side == other]
        clear = [one for one in looked if not one.hidden]
        if looked:
            shown = max(clear or looked, key=lambda one: float(one.box[3] - one.box[1]))
            view = view_of(shown.drive)
            frame = -1 if view is None else int(view.frames.frame[shown.best])
            row |= {f"drive_{other}": shown.drive, f"frame_{other}": frame}
            row[f"box_{other}"] = shown.box.tolist()
        if clear:
            row["change"] = "gone" if self.side == "before" else "new"
            between = min(abs(one.time_ns - time) for one in clear for time in self.times_ns)
            misses = row[f"drives_{self.side}"] - row[f"seen_{self.side}"]
            # that at least one of the sightings is right
            wrong = [1.0 if one is None else 1 - one for one in self.confidences]
            confidence = float(1 - np.prod(wrong))
            row["probability"] = gone_probability(
                confidence, between / YEAR_NS, len(clear), misses, settings
            )
        return row


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
    row_of = {int(view.frames.frame[row]): int(row) for _, one in coverages for row in one.rows}
    kept: dict[int, NDArray[np.uint8]] = {}
    for image in read_images(folder, None, row_of.keys()):
        row = row_of[image.frame.index]
        if image.grey is not None:
            kept[row] = image.grey
        while waiting and waiting[0][1].rows[-1] <= row:
            absence, coverage = waiting.pop(0)
            images = _images_of(absence, coverage, view, kept)
            width, height = absence.size_m.tolist()
            past, hidden = measure_occlusion(images, view.camera, (width, height), settings)
            coverage.hidden = hidden > 0 and hidden >= past
        first = min((int(one.rows[0]) for _, one in waiting), default=row + 1)
        kept = {old: grey for old, grey in kept.items() if old >= first}
    if waiting:
        last = int(view.frames.frame[waiting[-1][1].rows[-1]])
        raise InputError(
            f"{folder}: its log ends before image {last}: it is shorter than it was at the run"
        )


def _images_of(
    absence: Absence, coverage: Coverage, view: DriveView, kept: dict[int, NDArray[np.uint8]]
) -> list[PlaceImage]:
    """The images of a coverage that were decoded, relative to the place."""
    rows = np.array([row for row in coverage.rows.tolist() if row in kept], np.int64)
    lon, lat, up = absence.place.tolist()
    centre = view.centres(LocalOrigin(lat, lon, up), coverage.offset_m, rows)
    turned = view.frames.rotation[rows]
    grey = [kept[row] for row in rows.tolist()]
    return [PlaceImage(*one) for one in zip(grey, turned, centre, strict=True)]
