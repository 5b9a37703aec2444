"""What the models of a run say of where they were learned: whether this log was among it."""

from __future__ import annotations

import re
from collections.abc import Mapping

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass

_METADATA_FIELD = 14
"""`ModelProto.metadata_props` of onnx.proto, https://github.com/onnx/onnx: pairs of `key` (1) and `value` (2)."""


def learned_from(log: str, provenances: Mapping[str, str]) -> tuple[str, ...]:
    """Names of the models whose provenance lists a log among its sources.

    Parameters
    ----------
    log
        Stem of the log's file name. A source is listed by it, maybe behind the name of a folder and a slash, and
        followed by how much it gave: `drive (60 images, ...` or `drive: 42 images`.
    provenances
        What each model says of itself, by the model's name.
    """
    source = re.compile(rf"(?<![^\s/;,]){re.escape(log)}(?: \(|: )\d")
    return tuple(name for name, text in provenances.items() if source.search(text))


def onnx_metadata(content: bytes) -> dict[str, str]:
    """Metadata of a network by the content of its ONNX file; none where it is not one."""
    model = _model()
    try:
        model.ParseFromString(content)
    except DecodeError:
        return {}
    return {pair.key: pair.value for pair in getattr(model, "metadata_props", ())}


def _model() -> Message:
    """An empty `ModelProto` that knows its metadata alone; all else is skipped."""
    kind = FieldDescriptorProto
    file = FileDescriptorProto(name="onnx_metadata.proto", package="onnx", syntax="proto3")
    pair = file.message_type.add(name="StringStringEntryProto")
    for number, name in enumerate(("key", "value"), 1):
        pair.field.add(name=name, number=number, type=kind.TYPE_STRING, label=kind.LABEL_OPTIONAL)
    file.message_type.add(name="ModelProto").field.add(
        name="metadata_props",
        number=_METADATA_FIELD,
        type=kind.TYPE_MESSAGE,
        type_name=".onnx.StringStringEntryProto",
        label=kind.LABEL_REPEATED,
    )
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("onnx.ModelProto"))()
