"""Bytes of a message to an object with the message's fields as attributes: protobuf, ROS 2 CDR, JSON.

The pixels of an image (its field `data`) are handed on beside it and, where the encoding allows it, not copied:
they are most of a log.
"""

from __future__ import annotations

import binascii
import json
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any

from mcap.records import Schema as McapSchema
from mcap_protobuf.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from wayside.pipeline.reading.layout import Channel

Unpacked = tuple[Any, memoryview]
"""The message, and the bytes of its field `data` (empty where it has none)."""

Unpack = Callable[[memoryview], Unpacked]

_NOTHING = memoryview(b"")
_VIDEO_FIELDS = "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
"""Of the one type that is understood and not of ROS itself; https://github.com/foxglove/schemas"""


class EncodingError(ValueError):
    """Messages of a channel that cannot be unpacked at all."""


def unpacker_for(channel: Channel, type_name: str) -> Unpack:
    """How messages of a channel are unpacked; `type_name` as `foxglove.Type` or `package/msg/Type`.

    Raises
    ------
    EncodingError
        The encoding is unknown or does not go with the schema.
    """
    if channel.encoding == "protobuf":
        return _protobuf(channel)
    if channel.encoding == "cdr":
        return _cdr(type_name)
    if channel.encoding == "json":
        return unpack_json
    raise EncodingError(
        f"encoding {channel.encoding!r} is not understood; protobuf, cdr and json are"
    )


def _protobuf(channel: Channel) -> Unpack:
    schema = channel.schema
    if schema is None:
        raise EncodingError("it has no schema")
    stock = McapSchema(schema.id, schema.data, schema.encoding, schema.name)
    try:
        decode = DecoderFactory().decoder_for("protobuf", stock)
    except (
        Exception
    ) as error:  # a damaged descriptor fails in many ways inside the protobuf runtime
        raise EncodingError(f"its protobuf schema is damaged ({error})") from error
    if decode is None:
        raise EncodingError(f"its schema is in {schema.encoding!r}, not protobuf")
    field = decode(b"").DESCRIPTOR.fields_by_name.get("data")

    def unpack(content: memoryview) -> Unpacked:
        if field is None or field.type != field.TYPE_BYTES:
            return decode(bytes(content)), _NOTHING
        rest, data = cut_out_field(content, field.number)
        return decode(rest), data

    return unpack


def cut_out_field(content: memoryview, number: int) -> tuple[bytes, memoryview]:
    """A protobuf message without its length-delimited field `number`, and that field's bytes (the last, if repeated).

    Wire format: https://protobuf.dev/programming-guides/encoding. Raises ValueError where a length does not fit.
    """
    rest, data = bytearray(), _NOTHING
    position, end = 0, len(content)
    while position < end:
        start = position
        tag, position = _varint(content, position)
        wire_type = tag & 7
        if wire_type == 0:
            _, position = _varint(content, position)
        elif wire_type == 1:
            position += 8
        elif wire_type == 5:
            position += 4
        elif wire_type == 2:
            length, position = _varint(content, position)
            position += length
        else:
            raise ValueError(f"wire type {wire_type} in a protobuf message")
        if position > end:
            raise ValueError("a protobuf field reaches beyond its message")
        if wire_type == 2 and tag >> 3 == number:
            data = content[position - length : position]
        else:
            rest += content[start:position]
    return bytes(rest), data


def _varint(content: memoryview, position: int) -> tuple[int, int]:
    value = shift = 0
    while position < len(content) and shift < 70:
        byte = content[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
    raise ValueError("a protobuf number without an end")


@cache
def _typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_VIDEO_FIELDS, "foxglove_msgs/msg/CompressedVideo"))
    return store


def _cdr(type_name: str) -> Unpack:
    store = _typestore()
    if type_name not in store.fielddefs:
        raise EncodingError(f"type {type_name} is not understood in CDR")

    def unpack(content: memoryview) -> Unpacked:
        message: Any = store.deserialize_cdr(content, type_name)
        data = getattr(message, "data", None)
        return message, _NOTHING if data is None else memoryview(data)

    return unpack


def unpack_json(content: memoryview) -> Unpacked:
    """A JSON message; the base64 text of `data`, which holds no escapes, is not sent through the JSON reader."""
    text = bytes(content)
    key = text.find(b'"data"')
    quote = text.find(b'"', key + 6)
    closing = text.find(b'"', quote + 1)
    if key >= 0 and closing > 0 and text[key + 6 : quote].strip() == b":":
        message = _attributes(text[: quote + 1] + text[closing:])
        return message, memoryview(binascii.a2b_base64(text[quote + 1 : closing]))
    message = _attributes(text)
    numbers = getattr(message, "data", None)
    return message, memoryview(bytes(numbers)) if isinstance(numbers, list) else _NOTHING


def _attributes(text: bytes) -> Any:
    message = json.loads(text, object_hook=lambda fields: SimpleNamespace(**fields))
    if not isinstance(message, SimpleNamespace):
        raise ValueError("a JSON message that is no object")
    return message
