"""Numbered images to a log (`wayside import`)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from mcap.writer import CompressionType
from mcap_protobuf.writer import Writer

from wayside.pipeline.files.input_files import read_input
from wayside.pipeline.files.writing import whole_file
from wayside.pipeline.logs.positions import place_images, utc
from wayside.pipeline.reading.calibrations import read_camera_file
from wayside.pipeline.reading.image_headers import refuse_turned
from wayside.pipeline.reading.image_order import (
    ImageFile,
    copies_among,
    counted,
    image_files,
    in_order,
    natural_key,
    read_image_file,
)
from wayside.pipeline.reading.plan import listed
from wayside.pipeline.reading.survey import (
    BY_NUMBER_KEY,
    DATES_METADATA,
    METADATA_NAME,
    NAMES_METADATA,
    SPACING_KEY,
)
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import RouteSettings

SECOND_NS = 10**9
"""Time between logged images whose times are not known, from the date on; none has a capture time."""

_CAMERA_FRAME = "camera"


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """Options that describe the images and the log."""

    spacing_m: float | None = None
    """Distance between images of neighbouring numbers; None: positions tell it."""
    date: datetime | None = None
    """Of the first image, UTC where it has no zone; None: the earliest date of capture."""
    positions: Path | None = None
    routes: RouteSettings = field(default_factory=RouteSettings)
    """Both as for `place_images`."""
    order: str = ""
    """"name" or "date" decides the order where they contradict each other; empty: that is refused."""
    overwrite: bool = False
    """Replace a file of that name that is not this very log."""


class Imported(NamedTuple):
    """What was imported: images, files left out, images with a position, and when it begins (None: unknown)."""

    images: int
    left_out: int
    placed: int
    begin: datetime | None


def import_images(
    images: list[Path],
    calibration: Path,
    out: Path,
    how: ImportOptions,
    *,
    warn: Callable[[str], None] = lambda words: None,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> Imported:
    """Write a log of numbered images, a known distance apart or with positions.

    Images are sorted by the time when they were taken (`in_order`) and copied byte for byte, with their file names and
    camera dates. Those whose position is known get a fix. Numbers that are missing from an even count are taken for
    images not taken: the distance across the gap is the larger. Copies of an image are imported, too; a run leaves them
    out. Files that are no images or cannot be read are left out.

    `images`: JPEG and PNG files, and folders of them. `calibration`: YAML of ROS camera_info, OpenCV or Kalibr.
    `warn`: called with a sentence about faulty images. `watch`: called with the numbers of images written and in all.
    Raises UsageError without an image, or without a positive spacing or two positions. Raises InputError if the
    calibration, the positions or an image cannot be used, sizes differ, or nothing tells the order. Raises OutputError
    as `whole_file`.
    """
    if how.spacing_m is not None and not how.spacing_m > 0:
        raise UsageError(
            f"--spacing: {how.spacing_m:g} m is not a distance between images. Give it as in 26.4ft or 8.05m."
        )
    camera = read_camera_file(calibration)
    files = list(dict.fromkeys(image_files(images)))
    if not files:
        raise UsageError(
            "no images to import are given. Give JPEG or PNG files, or folders of them."
        )
    usable, left_out = _usable(files, camera)
    if left_out:
        warn(f"left out: {len(left_out)} of {len(files)} files ({listed(left_out)})")
    copies = copies_among(usable)
    ordered, counts = _numbered(in_order(usable, copies, how.order), copies)
    places = place_images(ordered, how.positions, how.routes)
    if how.spacing_m is None and len(places) < 2:
        raise UsageError(
            "it is unknown how far apart the images are: give --spacing 26.4ft, or --positions FILE (GPX or CSV)."
        )
    dates = [image.exif.taken for image in ordered if image.exif.taken is not None]
    begin = how.date or min(dates, key=_utc_ns, default=None)
    times = _times_of(ordered, counts, 0 if begin is None else _utc_ns(begin))
    for words in _warnings([image.path for image in ordered], counts, copies):
        warn(words)
    with whole_file(out, overwrite=how.overwrite) as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        _describe(writer, dict(zip(map(str, times), ordered, strict=True)), how.spacing_m)
        writer.write_message("/camera/calibration", _calibration(camera), times[0], times[0], 1)
        for done, (image, count, time_ns) in enumerate(zip(ordered, counts, times, strict=True), 1):
            writer.write_message("/camera/image", _message(image), time_ns, time_ns, count)
            if (at := places.get(image.path)) is not None:
                fix = LocationFix(latitude=at.lat_deg, longitude=at.lon_deg, altitude=at.alt_m)
                writer.write_message("/gps", fix, time_ns, time_ns, count)
            watch(done, len(ordered))
        writer.finish()  # type: ignore[no-untyped-call]
    return Imported(len(ordered), len(left_out), len(places), begin)


def _describe(writer: Writer, timed: dict[str, ImageFile], spacing_m: float | None) -> None:
    """The metadata of a log: the distance between images, and name and date of each by its time in the log."""
    if spacing_m is not None:
        writer.add_metadata(METADATA_NAME, {SPACING_KEY: repr(spacing_m), BY_NUMBER_KEY: "yes"})
    writer.add_metadata(NAMES_METADATA, {time: image.path.name for time, image in timed.items()})
    if dates := {time: one.exif.date for time, one in timed.items() if one.exif.date}:
        writer.add_metadata(DATES_METADATA, dates)


def _usable(files: list[Path], camera: Camera) -> tuple[list[ImageFile], list[str]]:
    """The files that can be imported, and the others with the reasons. Raises InputError if no file can be imported."""
    usable, left_out = [], []
    for file in files:
        image = read_image_file(file)
        if isinstance(image, str):
            left_out.append(f"{file.name}: {image}")
            continue
        refuse_turned(str(file), image.exif)
        if (image.header.width, image.header.height) != (camera.width, camera.height):
            raise InputError(
                f"{file}: the image has {image.header.width} x {image.header.height} pixels, but the calibration is "
                f"for {camera.width} x {camera.height}. Give the calibration of these images."
            )
        usable.append(image)
    if not usable:
        raise InputError(f"none of {len(files)} files can be imported: {listed(left_out)}")
    return usable, left_out


def _numbered(
    images: list[ImageFile], copies: dict[Path, Path]
) -> tuple[list[ImageFile], list[int]]:
    """The images in order with their counts; copies whose names break an even count come behind their originals."""
    files = [image.path for image in images]
    originals = [file for file in files if file not in copies]
    counts = counted(originals)
    if counted(files) is not None or counts is None:
        return images, counted(files) or list(range(1, len(files) + 1))
    known = dict(zip(originals, counts, strict=True))
    number = {file: known[copies.get(file) or file] for file in files}
    ordered = sorted(images, key=lambda image: (number[image.path], image.path in copies))
    return ordered, [number[image.path] for image in ordered]


def _warnings(files: list[Path], counts: list[int], copies: dict[Path, Path]) -> Iterator[str]:
    folders = list(dict.fromkeys(str(file.parent) for file in files))
    if len(folders) > 1:
        yield f"folders are taken in this order: {listed(folders)}"
    if copies:
        pairs = [f"{copy.name} of {original.name}" for copy, original in copies.items()]
        yield (
            f"copies, byte for byte: {len(copies)} ({listed(pairs)}); a run gives them the status "
            "`duplicate` and adds no distance for them"
        )
    originals = [file for file in files if file not in copies]
    if len(files) > 1 and counted(originals) is None and counted(files) is None:
        yield (
            "the numbers in the names do not rise evenly: images are assumed to be one spacing apart, and "
            "missing ones go unnoticed"
        )
    back = [
        f"{after.name} behind {before.name}"
        for before, after in pairwise(originals)
        if before.parent == after.parent and natural_key(after) < natural_key(before)
    ]
    if back:
        yield f"numbers start again or go back: {listed(back)}"
    gaps = [(b - a - 1, file) for (a, b), file in zip(pairwise(counts), files, strict=False)]
    places = [f"{missing} after {before.name}" for missing, before in gaps if missing > 0]
    if places:
        yield (
            f"missing numbers: {sum(max(missing, 0) for missing, _ in gaps)} ({listed(places)}); each adds one "
            "spacing to the distance across its gap"
        )


def _utc_ns(time: datetime) -> int:
    return int(utc(time).timestamp()) * SECOND_NS + time.microsecond * 1000


def _times_of(images: list[ImageFile], counts: list[int], begin_ns: int) -> list[int]:
    """Log times that distinguish images: by dates of capture where they rise, else a second per trigger.

    Copies of one number come a nanosecond later.
    """
    taken = [_utc_ns(one.exif.taken) for one in images if one.exif.taken is not None]
    if len(taken) == len(images) and all(a < b for a, b in pairwise(taken)):
        return [begin_ns + time - taken[0] for time in taken]
    times: list[int] = []
    for count in counts:
        times.append(max(begin_ns + (count - 1) * SECOND_NS, times[-1] + 1 if times else 0))
    return times


def _message(image: ImageFile) -> CompressedImage:
    try:
        data = read_input(image.path)
    except OSError as error:
        raise InputError(
            f"{image.path}: it could be read before, but not now: {error.strerror or error}; check the file"
        ) from error
    return CompressedImage(data=data, format=image.header.encoding, frame_id=_CAMERA_FRAME)


def _calibration(camera: Camera) -> CameraCalibration:
    c = camera
    return CameraCalibration(
        width=c.width,
        height=c.height,
        distortion_model="rational_polynomial" if len(c.distortion) > 5 else "plumb_bob",
        D=c.distortion,
        K=c.matrix.ravel().tolist(),
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        frame_id=_CAMERA_FRAME,
    )
