"""Numbered images to a log (`wayside import`)."""

from __future__ import annotations

import re
from collections.abc import Iterator
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

from wayside.pipeline.reading.camera_file import read_camera_file
from wayside.pipeline.reading.image_headers import read_image_header
from wayside.pipeline.reading.survey import BY_NUMBER_KEY, METADATA_NAME, SPACING_KEY
from wayside.pipeline.writing import whole_file
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Camera

SECOND_NS = 10**9
"""Imported images have no times: they are logged one second apart, from 0 on, and carry no capture time."""

_SUFFIXES = {".jpg", ".jpeg", ".png"}
_WIDEST_GAP = 20
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
) -> int:
    """Write a log of numbered images, a known distance apart, and return how many there are.

    Images are sorted by the numbers in their names and passed through byte for byte. Numbers that are missing from
    an even count are taken for images not taken: the distance across the gap is the larger.

    Parameters
    ----------
    images
        JPEG and PNG files, and folders of them.
    calibration
        ROS camera_info YAML of the camera.
    spacing_m
        Distance between images of neighbouring numbers, metres.
    out
        The MCAP file to write; it appears when it is complete.
    overwrite
        Replace a file of that name that is not this very log.

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
    files = sorted(image_files(images), key=natural_key)
    if not files:
        raise UsageError(
            "wanted images to import, found none; give JPEG or PNG files or folders of them"
        )
    counts = count_images(files)
    with whole_file(out, overwrite=overwrite) as stream:
        _write(Writer(stream, compression=CompressionType.NONE), files, counts, camera, spacing_m)
    return len(files)


def count_images(files: list[Path]) -> list[int]:
    """Which trigger each image is of, from 1 on, by the last number in its name.

    Where the numbers do not rise in multiples of their smallest step, or leap far (times, for instance), the images
    are counted one by one.
    """
    plain = list(range(1, len(files) + 1))
    digits = [re.findall(r"\d+", file.stem) for file in files]
    if len(files) < 2 or not all(digits):
        return plain
    numbers = [int(found[-1]) for found in digits]
    steps = [b - a for a, b in pairwise(numbers)]
    step = min(steps)
    if step < 1 or any(s % step or s > _WIDEST_GAP * step for s in steps):
        return plain
    return [(n - numbers[0]) // step + 1 for n in numbers]


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
    return [(0, int(p), "") if p.isdigit() else (1, 0, p) for p in pieces if p], str(path)


def _write(
    writer: Writer, files: list[Path], counts: list[int], camera: Camera, spacing_m: float
) -> None:
    writer.start(library="wayside")
    writer.add_metadata(METADATA_NAME, {SPACING_KEY: repr(spacing_m), BY_NUMBER_KEY: "yes"})
    calibration = _message("CameraCalibration", _CALIBRATION)
    image = _message("CompressedImage", _IMAGE)
    channel = _register(writer, "/camera/calibration", calibration)
    writer.add_message(channel, 0, _fill_calibration(calibration, camera), 0, 1)
    channel = _register(writer, "/camera/image", image)
    for file, count in zip(files, counts, strict=True):
        data, encoding = _read_image(file, camera)
        content = type(image)(data=data, format=encoding, frame_id=_CAMERA_FRAME)
        time_ns = (count - 1) * SECOND_NS
        writer.add_message(channel, time_ns, content.SerializeToString(), time_ns, count)
    writer.finish()  # type: ignore[no-untyped-call]


def _read_image(file: Path, camera: Camera) -> tuple[bytes, str]:
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(
            f"{file}: wanted an image, found: {error.strerror or error}; check the file"
        ) from error
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
