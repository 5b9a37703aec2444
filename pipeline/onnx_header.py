"""What an ONNX file says of itself: inputs, outputs, metadata. The messages of the format are read, not its weights.

Field numbers as in onnx.proto (https://github.com/onnx/onnx); fields that are not listed are passed over.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass

FLOAT32 = 1
"""Element type of an input of single precision."""

_Kind = FieldDescriptorProto
_TEXT, _LONG, _WHOLE, _PART = (
    _Kind.TYPE_STRING,
    _Kind.TYPE_INT64,
    _Kind.TYPE_INT32,
    _Kind.TYPE_MESSAGE,
)
_MESSAGES: dict[str, tuple[tuple[str, int, _Kind.Type.ValueType, str], ...]] = {
    "Dimension": (("dim_value", 1, _LONG, ""),),
    "Shape": (("dim", 1, _PART, "Dimension"),),
    "Tensor": (("elem_type", 1, _WHOLE, ""), ("shape", 2, _PART, "Shape")),
    "Type": (("tensor_type", 1, _PART, "Tensor"),),
    "Value": (("name", 1, _TEXT, ""), ("type", 2, _PART, "Type")),
    "Weights": (("name", 8, _TEXT, ""),),
    "Graph": (
        ("initializer", 5, _PART, "Weights"),
        ("input", 11, _PART, "Value"),
        ("output", 12, _PART, "Value"),
    ),
    "Entry": (("key", 1, _TEXT, ""), ("value", 2, _TEXT, "")),
    "Model": (("graph", 7, _PART, "Graph"), ("metadata_props", 14, _PART, "Entry")),
}
_REPEATED = {"dim", "initializer", "input", "output", "metadata_props"}


@dataclass(frozen=True, slots=True)
class OnnxInput:
    """An input of a network: element type as in ONNX, and its shape, 0 where a side is not fixed."""

    name: str
    element: int
    shape: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class OnnxHeader:
    """Inputs, names of the outputs, and metadata of a network."""

    inputs: tuple[OnnxInput, ...]
    outputs: tuple[str, ...]
    metadata: dict[str, str]


def read_onnx_header(data: bytes) -> OnnxHeader:
    """The header of an ONNX file; raises ValueError where the bytes are none."""
    model = _model_class()()
    try:
        model.ParseFromString(data)
    except DecodeError as error:
        raise ValueError("bytes that are no ONNX network") from error
    graph = model.graph  # type: ignore[attr-defined]
    weights = {entry.name for entry in graph.initializer}  # old files list these as inputs, too
    inputs = tuple(
        OnnxInput(
            value.name,
            value.type.tensor_type.elem_type,
            tuple(max(side.dim_value, 0) for side in value.type.tensor_type.shape.dim),
        )
        for value in graph.input
        if value.name not in weights
    )
    outputs = tuple(value.name for value in graph.output)
    if not inputs or not outputs:
        raise ValueError("bytes without inputs and outputs of an ONNX network")
    metadata = {entry.key: entry.value for entry in model.metadata_props}  # type: ignore[attr-defined]
    return OnnxHeader(inputs, outputs, metadata)


@cache
def _model_class() -> type[Message]:
    file = FileDescriptorProto(name="onnx_header.proto", package="onnx_header", syntax="proto3")
    for name, fields in _MESSAGES.items():
        described = file.message_type.add(name=name)
        for field_name, number, kind, part in fields:
            label = _Kind.LABEL_REPEATED if field_name in _REPEATED else _Kind.LABEL_OPTIONAL
            field = described.field.add(name=field_name, number=number, label=label, type=kind)
            if part:
                field.type_name = f".onnx_header.{part}"
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("onnx_header.Model"))
