"""What the drives of an inventory had in view: their cameras, calibration and own detection range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.files.parsing import CONTENT_FAULTS
from wayside.pipeline.fleet.inventory_data import DriveFrames, read_frames, read_signs
from wayside.pipeline.results.result import read_run
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.stages.georeference import LocalOrigin
from wayside.stages.inventory import PanelPlaces, PanelViews, PlaceImage, views_of

SEEN_SHARE = 0.75
"""Share of a drive's panels first measured at the visible height, or less: its own detection range."""
FEWEST_SIGNS = 5
"""A drive with fewer panels takes `VISIBLE_PX` (estimate)."""
VISIBLE_PX = 25.0
"""Height of a visible face, where the drive does not tell: nearly all of it are found on rendered drives."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class DriveView:
    """A drive that can say what it had in view.

    `name`: folder of the result. `frames`, `camera`: see there. `smallest_px`: height of a face from which on it
    measures them.
    """

    name: str
    frames: DriveFrames
    camera: Camera
    smallest_px: float

    def views(
        self, places: PanelPlaces, origin: LocalOrigin, offset_m: Floats, settings: ChangeSettings
    ) -> tuple[Ints, PanelViews]:
        """Rows of its frames near places about an origin, and what these show.

        offset_m (3,): error of the drive's positions there.
        """
        centre = self._centres(origin, offset_m, slice(None))
        low, high = places.position[:, :2].min(axis=0), places.position[:, :2].max(axis=0)
        low, high = low - settings.farthest_m, high + settings.farthest_m
        near = ((centre[:, :2] > low) & (centre[:, :2] < high)).all(axis=1)
        rows = np.flatnonzero(near)
        found = views_of(
            places, centre[rows], self.frames.rotation[rows], self.camera, self.smallest_px
        )
        return rows, found

    def place_images(
        self, place: Floats, offset_m: Floats, rows: Ints, grey: Sequence[NDArray[np.uint8]]
    ) -> list[PlaceImage]:
        """Images of its frames (rows) relative to a place (3,): longitude, latitude, height; offset_m as in `views`."""
        lon, lat, up = place.tolist()
        centre = self._centres(LocalOrigin(lat, lon, up), offset_m, rows)
        turned = self.frames.rotation[rows]
        return [PlaceImage(*one) for one in zip(grey, turned, centre, strict=True)]

    def _centres(self, origin: LocalOrigin, offset_m: Floats, rows: Ints | slice) -> Floats:
        return np.asarray(origin.topocentric(self.frames.geodetic[rows]) - offset_m, np.float64)


def read_view(folder: Path) -> DriveView | None:
    """The cameras of a drive; None where its result does not hold their places, headings and calibration.

    Raises
    ------
    InputError
        The folder is no result, or damaged.
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
