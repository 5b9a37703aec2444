"""Positions of images to import: by their Exif data, a GPX track, or a CSV of files, times, places or mileposts."""

import csv
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from wayside.pipeline.files.input_files import read_input
from wayside.pipeline.files.parsing import CONTENT_FAULTS, read_csv
from wayside.pipeline.files.route_file import open_routes
from wayside.pipeline.reading.image_headers import Place
from wayside.pipeline.reading.image_order import ImageFile
from wayside.pipeline.reading.series import WIDEST_GAP_S
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.settings import RouteSettings
from wayside.stages.kernels import Array

_QUARTER_S = 900
"""Time zones differ by multiples of this."""
_ZONES = range(-48, 57)
_NUMBERS = ("lon", "lat", "alt", "milepost")


_Positions = tuple[dict[str, Place], list[tuple[datetime, Place]]]
"""Places by the name of the image's file, and those of a track with their times."""


def place_images(
    images: Sequence[ImageFile], file: Path | None, routes: RouteSettings
) -> dict[Path, Place]:
    """Where images were taken, of those that are known; without `file` by their Exif data.

    `file`: GPX or CSV. The CSV has the columns `file` or `time` (ISO 8601), and `lon` and `lat` (WGS 84, degrees;
    `alt`, m) or `route` and `milepost`. `routes`: the lines on which mileposts lie. A track is interpolated at the
    times of capture. If these are local times of an unknown zone, it is the one in which the track covers most of them.

    Raises InputError where the file cannot be read, is of no image, or images have no times or zone. Raises UsageError
    for mileposts without lines.
    """
    if file is None:
        return {one.path: one.exif.place for one in images if one.exif.place is not None}
    try:
        by_name, track = _gpx(file) if file.suffix.lower() == ".gpx" else _table(file, routes)
    except (OSError, csv.Error, ElementTree.ParseError, *CONTENT_FAULTS) as error:
        raise InputError(
            f"{file}: the positions cannot be read: {error}. Give GPX, or CSV with file or time, and lon and lat or "
            "route and milepost."
        ) from error
    places = {one.path: by_name[k] for one in images if (k := one.path.name) in by_name}
    if track:
        places |= _along(track, images, file)
    if not places:
        raise InputError(f"{file}: the positions match none of these {len(images)} images.")
    return places


def _gpx(file: Path) -> _Positions:
    """Points of all tracks with a time; the namespace depends on the version."""
    points = ElementTree.fromstring(read_input(file)).iterfind(".//{*}trkpt")
    track = []
    for point in points:
        if time := point.findtext("{*}time"):
            height = float(point.findtext("{*}ele") or "nan")
            place = Place(float(point.attrib["lat"]), float(point.attrib["lon"]), height)
            track.append((datetime.fromisoformat(time.strip()), place))
    return {}, track


def _table(file: Path, routes: RouteSettings) -> _Positions:
    names, rows = read_csv(file, _NUMBERS)
    if "milepost" in names:
        lines = open_routes(routes)
        if lines is None:
            raise UsageError(f"{file}: mileposts need route lines: give --routes FILE.")
        level = lines.places([(row["route"], float(row["milepost"])) for row in rows])
    else:
        level = [(float(row["lat"]), float(row["lon"])) for row in rows]
    places = [Place(*at, float(r.get("alt", "nan"))) for at, r in zip(level, rows, strict=True)]
    if "file" in names:
        return {Path(r["file"]).name: p for r, p in zip(rows, places, strict=True)}, []
    times = [datetime.fromisoformat(row["time"]) for row in rows]
    return {}, list(zip(times, places, strict=True))


def _along(
    track: Sequence[tuple[datetime, Place]], images: Sequence[ImageFile], file: Path
) -> dict[Path, Place]:
    """Places of the images that a track covers."""
    dated = {one.path: one.exif.taken for one in images if one.exif.taken is not None}
    if not dated:
        raise InputError(
            f"{file}: positions of a track need the time of each image, and no image has one (Exif)."
        )
    ordered = sorted((utc(time).timestamp(), place) for time, place in track)
    at, places = np.array([time for time, _ in ordered]), np.array([one for _, one in ordered])
    taken = np.array([utc(time).timestamp() for time in dated.values()])
    if track[0][0].tzinfo and not any(time.tzinfo for time in dated.values()):
        taken = taken + _zone(taken, at, file)
    after = np.searchsorted(at, taken).clip(1, max(len(at) - 1, 1))
    known = (taken >= at[0]) & (taken <= at[-1])
    known &= np.diff(at, append=at[-1])[after - 1] <= WIDEST_GAP_S
    held = np.column_stack([np.interp(taken, at, column) for column in places.T])
    return {
        path: Place(*row)
        for path, row, use in zip(dated, held.tolist(), known.tolist(), strict=True)
        if use
    }


def utc(time: datetime) -> datetime:
    """A time with its zone; without one it is UTC."""
    return time if time.tzinfo else time.replace(tzinfo=UTC)


def _zone(taken: Array, track: Array, file: Path) -> float:
    """Seconds from local times to UTC; raises InputError unless one zone alone puts most images on the track."""
    shifts = np.array(_ZONES) * _QUARTER_S
    moved = taken[:, None] + shifts
    covered = ((moved >= track[0]) & (moved <= track[-1])).sum(axis=0)
    best = np.flatnonzero(covered == covered.max())
    if len(best) != 1:
        raise InputError(
            f"{file}: {len(best)} time zones fit the times of the images. Write the right one into these (exiftool "
            "-OffsetTimeOriginal=+01:00 *.jpg)."
        )
    return float(shifts[best[0]])
