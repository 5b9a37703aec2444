"""Numbered images to a log (`wayside import`)."""

from __future__ import annotations

import io
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from hashlib import blake2b
from itertools import pairwise
from pathlib import Path

from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP_FILE
from mcap.writer import CompressionType, Writer
from PIL import Image

from wayside.pipeline.input_files import read_input
from wayside.pipeline.reading.camera_file import read_camera_file
from wayside.pipeline.reading.image_headers import read_image_header
from wayside.pipeline.reading.survey import (
    BY_NUMBER_KEY,
    DATES_METADATA,
    METADATA_NAME,
    NAMES_METADATA,
    SPACING_KEY,
)
from wayside.pipeline.writing import whole_file
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Camera

SECOND_NS = 10**9
"""Imported images have no times: they are logged one second apart, from 0 on, and carry no capture time."""

_SUFFIXES = {".jpg", ".jpeg", ".png"}
_WIDEST_GAP = 20
_MOST_LISTED = 6
_EXIF, _DATE_TAKEN, _DATE_CHANGED = 0x8769, 0x9003, 0x0132
"""Tags of the Exif standard: its directory, DateTimeOriginal in it, and DateTime."""
_CAMERA_FRAME = "camera"

_Kind = FieldDescriptorProto
_Fields = tuple[tuple[str, int, "FieldDescriptorProto.Type.ValueType"], ...]
_IMAGE: _Fields = (
    ("timestamp", 1, _Kind.TYPE_MESSAGE),
    ("data", 2, _Kind.TYPE_BYTES),
    ("format", 3, _Kind.TYPE_STRING),
    ("frame_id", 4, _Kind.TYPE_STRING),
)
_CALIBRATION: _Fields = (
    ("timestamp", 1, _Kind.TYPE_MESSAGE),
    ("width", 2, _Kind.TYPE_FIXED32),
    ("height", 3, _Kind.TYPE_FIXED32),
    ("distortion_model", 4, _Kind.TYPE_STRING),
    ("D", 5, _Kind.TYPE_DOUBLE),
    ("K", 6, _Kind.TYPE_DOUBLE),
    ("R", 7, _Kind.TYPE_DOUBLE),
    ("P", 8, _Kind.TYPE_DOUBLE),
    ("frame_id", 9, _Kind.TYPE_STRING),
)


def import_images(
    images: list[Path],
    calibration: Path,
    spacing_m: float,
    out: Path,
    *,
    overwrite: bool = False,
    warn: Callable[[str], None] = lambda words: None,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Write a log of numbered images, a known distance apart, and return how many there are.

    Images are sorted by the numbers in their names and passed through byte for byte, with the names of their files and
    the dates that their cameras wrote into them. Numbers that are missing from an even count are taken for images not
    taken: the distance across the gap is the larger. Copies of an image are imported, too; a run leaves them out.

    Parameters
    ----------
    images
        JPEG and PNG files, and folders of them.
    calibration
        YAML of ROS camera_info, OpenCV or Kalibr.
    spacing_m
        Distance between images of neighbouring numbers, metres.
    out
        The MCAP file to write; it appears when it is complete.
    overwrite
        Replace a file of that name that is not this very log.
    warn
        Called with what is amiss with the images, in words: copies, missing numbers.
    watch
        Called with how many images are written, and of how many.

    Raises
    ------
    UsageError
        The spacing is not positive, or there is no image among the paths.
    InputError
        An image or the calibration cannot be used.
    OutputError
        The log cannot be written, or another file of that name stands there.
    """
    if not spacing_m > 0:
        raise UsageError(
            f"--spacing: wanted the distance between images, found {spacing_m:g} m; "
            "give it as in 26.4ft or 8.05m"
        )
    camera = read_camera_file(calibration)
    files = sorted(set(image_files(images)), key=natural_key)
    if not files:
        raise UsageError(
            "wanted images to import, found none; give JPEG or PNG files or folders of them"
        )
    copies = copies_among(files)
    files, counts = _numbered(files, copies)
    for words in _warnings(files, counts, copies):
        warn(words)
    with whole_file(out, overwrite=overwrite) as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        _write(writer, files, counts, camera, spacing_m, watch)
    return len(files)


def count_images(files: list[Path]) -> list[int]:
    """Which trigger each image is of, from 1 on, by the last number in its name.

    Where the numbers do not rise in multiples of their smallest step, or leap far (times, for instance), the images
    are counted one by one.
    """
    return _counted(files) or list(range(1, len(files) + 1))


def _counted(files: list[Path]) -> list[int] | None:
    digits = [re.findall(r"\d+", file.stem) for file in files]
    if len(files) < 2 or not all(digits):
        return None
    numbers = [int(found[-1]) for found in digits]
    steps = [b - a for a, b in pairwise(numbers)]
    step = min(steps)
    if step < 1 or any(s % step or s > _WIDEST_GAP * step for s in steps):
        return None
    return [(n - numbers[0]) // step + 1 for n in numbers]


def _numbered(files: list[Path], copies: dict[Path, Path]) -> tuple[list[Path], list[int]]:
    """The images in order with their counts; copies whose names break an even count come behind their originals."""
    originals = [file for file in files if file not in copies]
    counts = _counted(originals)
    if _counted(files) is not None or counts is None:
        return files, count_images(files)
    known = dict(zip(originals, counts, strict=True))
    number = {file: known[copies.get(file) or file] for file in files}
    ordered = sorted(files, key=lambda file: (number[file], file in copies))
    return ordered, [number[file] for file in ordered]


def copies_among(files: list[Path]) -> dict[Path, Path]:
    """Files that agree in every byte with another, each with the one of these that has the shortest name."""
    by_size: defaultdict[int, list[Path]] = defaultdict(list)
    for file in files:
        by_size[file.stat().st_size].append(file)
    by_content: defaultdict[bytes, list[Path]] = defaultdict(list)
    for same in by_size.values():
        for file in same if len(same) > 1 else ():
            by_content[blake2b(_bytes_of(file)).digest()].append(file)
    copies: dict[Path, Path] = {}
    for same in by_content.values():
        original = min(same, key=lambda file: len(file.name))
        copies |= {file: original for file in same if file is not original}
    return copies


def _warnings(files: list[Path], counts: list[int], copies: dict[Path, Path]) -> Iterator[str]:
    if copies:
        pairs = [f"{copy.name} of {original.name}" for copy, original in copies.items()]
        yield (
            f"copies, byte for byte: {len(copies)} ({_listed(pairs)}); a run gives them the status "
            "`duplicate` and adds no distance for them"
        )
    if (
        len(files) > 1
        and _counted([f for f in files if f not in copies]) is None
        and _counted(files) is None
    ):
        yield (
            "the numbers in the names do not rise evenly: images are taken to be one spacing apart, in the order of "
            "their names, and missing ones are not noticed"
        )
    gaps = [(b - a - 1, before) for (a, b), before in zip(pairwise(counts), files, strict=False)]
    gaps = [(missing, before) for missing, before in gaps if missing > 0]
    if gaps:
        places = [f"{missing} after {before.name}" for missing, before in gaps]
        yield (
            f"missing numbers: {sum(missing for missing, _ in gaps)} ({_listed(places)}); the distance across a gap "
            "is taken to be longer by one spacing for each"
        )


def _listed(words: list[str]) -> str:
    more = len(words) - _MOST_LISTED
    return ", ".join(words[:_MOST_LISTED]) + (f" and {more} more" if more > 0 else "")


def image_files(paths: list[Path]) -> Iterator[Path]:
    """Files among `paths` as they are, and the JPEG and PNG files of folders; raises InputError for what is missing."""
    for path in paths:
        if path.is_dir():
            yield from (f for f in path.iterdir() if f.suffix.lower() in _SUFFIXES)
        elif path.is_file():
            yield path
        else:
            raise InputError(f"{path}: wanted an image, found no such file; check the name")


def natural_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Numbers in a name compare as numbers: image 2 stands before image 10."""
    pieces = re.split(r"(\d+)", path.name.lower())
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in pieces if p], str(path)


def _write(
    writer: Writer,
    files: list[Path],
    counts: list[int],
    camera: Camera,
    spacing_m: float,
    watch: Callable[[int, int], None],
) -> None:
    writer.start(library="wayside")
    writer.add_metadata(METADATA_NAME, {SPACING_KEY: repr(spacing_m), BY_NUMBER_KEY: "yes"})
    times = _times_of(counts)
    named = {str(time_ns): file.name for time_ns, file in zip(times, files, strict=True)}
    writer.add_metadata(NAMES_METADATA, named)
    calibration = _message("CameraCalibration", _CALIBRATION)
    image = _message("CompressedImage", _IMAGE)
    channel = _register(writer, "/camera/calibration", calibration)
    writer.add_message(channel, 0, _fill_calibration(calibration, camera), 0, 1)
    channel = _register(writer, "/camera/image", image)
    dates: dict[str, str] = {}
    for done, (file, count, time_ns) in enumerate(zip(files, counts, times, strict=True), 1):
        data, encoding = _read_image(file, camera)
        if date := date_taken(data):
            dates[str(time_ns)] = date
        content = type(image)(data=data, format=encoding, frame_id=_CAMERA_FRAME)
        writer.add_message(channel, time_ns, content.SerializeToString(), time_ns, count)
        watch(done, len(files))
    if dates:
        writer.add_metadata(DATES_METADATA, dates)
    writer.finish()  # type: ignore[no-untyped-call]


def _times_of(counts: list[int]) -> list[int]:
    """Log times by which images are told apart: a second a trigger, copies of one number a nanosecond behind it."""
    times: list[int] = []
    for count in counts:
        times.append(max((count - 1) * SECOND_NS, times[-1] + 1 if times else 0))
    return times


def date_taken(data: bytes) -> str:
    """When an image was taken, `2009-05-14 10:31:07`, by its Exif data; empty where they do not say it."""
    try:
        with Image.open(io.BytesIO(data)) as image:
            exif = image.getexif()
            date = str(exif.get_ifd(_EXIF).get(_DATE_TAKEN) or exif.get(_DATE_CHANGED) or "")
    except (
        Exception
    ):  # the library has errors of its own for each damage, and a date is no reason to stop
        return ""
    found = re.match(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)", date)
    return "" if found is None else "{}-{}-{} {}".format(*found.groups())


def _bytes_of(file: Path) -> bytes:
    try:
        return read_input(file)
    except OSError as error:
        raise InputError(
            f"{file}: wanted an image, found: {error.strerror or error}; check the file"
        ) from error


def _read_image(file: Path, camera: Camera) -> tuple[bytes, str]:
    data = _bytes_of(file)
    header = read_image_header(data)
    if header is None or header.encoding not in ("jpeg", "png"):
        raise InputError(
            f"{file}: wanted a JPEG or PNG image, found a file that is neither or is cut off; "
            "convert it or leave it out"
        )
    if (header.width, header.height) != (camera.width, camera.height):
        raise InputError(
            f"{file}: wanted {camera.width} x {camera.height} pixels as the calibration has them, "
            f"found {header.width} x {header.height}; give the calibration of these images"
        )
    return data, header.encoding


def _fill_calibration(message: Message, camera: Camera) -> bytes:
    c = camera
    filled = type(message)(
        width=c.width,
        height=c.height,
        distortion_model="rational_polynomial" if len(c.distortion) > 5 else "plumb_bob",
        D=c.distortion,
        K=c.matrix.ravel().tolist(),
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        frame_id=_CAMERA_FRAME,
    )
    return filled.SerializeToString()


def _message(name: str, fields: _Fields) -> Message:
    """An empty message of a Foxglove schema; names, numbers and types of https://github.com/foxglove/foxglove-sdk."""
    file = FileDescriptorProto(
        name=f"foxglove/{name}.proto",
        package="foxglove",
        syntax="proto3",
        dependency=[TIMESTAMP_FILE.name],
    )
    described = file.message_type.add(name=name)
    for field_name, number, kind in fields:
        field = described.field.add(name=field_name, number=number, label=_Kind.LABEL_OPTIONAL)
        field.type = kind
        if kind == _Kind.TYPE_MESSAGE:
            field.type_name = ".google.protobuf.Timestamp"
        elif kind == _Kind.TYPE_DOUBLE:
            field.label = _Kind.LABEL_REPEATED
    pool = DescriptorPool()
    pool.AddSerializedFile(TIMESTAMP_FILE.serialized_pb)
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))()


def _register(writer: Writer, topic: str, message: Message) -> int:
    files = FileDescriptorSet()
    TIMESTAMP_FILE.CopyToProto(files.file.add())
    message.DESCRIPTOR.file.CopyToProto(files.file.add())
    schema = writer.register_schema(
        message.DESCRIPTOR.full_name, "protobuf", files.SerializeToString(deterministic=True)
    )
    return writer.register_channel(topic, "protobuf", schema)
