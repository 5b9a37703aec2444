"""Schemas that are known without the log: what a damaged definition can be compared with."""

from __future__ import annotations

import hashlib

from google.protobuf.descriptor_pb2 import DescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError

from wayside.pipeline.reading.layout import Schema
from wayside.pipeline.reading.messages import is_known_type

_PROTOBUF = {
    "foxglove.CameraCalibration": "9bb15681687db3e4",
    "foxglove.CompressedImage": "c0d843013c3a8842",
    "foxglove.FrameTransform": "e46103054e8f44e8",
    "foxglove.FrameTransforms": "ca46a64373a4b9a9",
    "foxglove.LocationFix": "a5c829e9a88b568c",
    "foxglove.PoseInFrame": "f99c18b6d4f86c6a",
    "foxglove.PosesInFrame": "312cc6b3e3938b25",
    "foxglove.RawImage": "991e6b8f41274f1c",
}
"""Of the Foxglove schemas (https://github.com/foxglove/foxglove-sdk), as `protobuf_fingerprint` gives them."""


def is_well_known(schema: Schema) -> bool:
    """Whether a schema is one that can be read, word for word: no damage in it can change what a message says.

    JSON and CDR messages are read by the name of their schema alone. Of protobuf, whose schema numbers the fields,
    names, numbers and types of all fields must be those published.
    """
    if schema.encoding != "protobuf":
        return is_known_type(schema.name)
    expected = _PROTOBUF.get(schema.name)
    return expected is not None and protobuf_fingerprint(schema.data) == expected


def protobuf_fingerprint(data: bytes) -> str:
    """Digest of the fields of a serialized FileDescriptorSet, whatever its comments and order; empty if it is none."""
    files = FileDescriptorSet()
    try:
        files.ParseFromString(data)
    except DecodeError:
        return ""
    lines = [
        line
        for file in files.file
        for message in file.message_type
        for line in _fields(f".{file.package}", message)
    ]
    return hashlib.sha256("\n".join(sorted(lines)).encode("utf-8", "replace")).hexdigest()[:16]


def _fields(scope: str, message: DescriptorProto) -> list[str]:
    name = f"{scope}.{message.name}"
    own = [
        f"{name} {field.name} {field.number} {field.type} {field.label} {field.type_name}"
        for field in message.field
    ]
    return own + [line for inner in message.nested_type for line in _fields(name, inner)]
