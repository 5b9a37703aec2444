"""Bytes of a message to an object with the message's fields as attributes: protobuf, ROS 2 CDR, JSON."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any

from mcap.records import Schema as McapSchema
from mcap_protobuf.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from wayside.pipeline.reading.contents import ContentError
from wayside.pipeline.reading.layout import Channel

Unpacked = tuple[Any, memoryview]
"""The message, and the bytes of its field `data` (empty where it has none)."""

Unpack = Callable[[memoryview], Unpacked]

_NOTHING = memoryview(b"")
_VIDEO_FIELDS = "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
"""Of the one type that is understood and not of ROS itself; https://github.com/foxglove/schemas"""

_STANDARD_ALPHABET = str.maketrans("-_", "+/")


def unpacker_for(channel: Channel, type_name: str) -> Unpack:
    """How messages of a channel are unpacked; `type_name` as `foxglove.Type` or `package/msg/Type`.

    Raises ContentError where the encoding is unknown or does not go with the schema.
    """
    if channel.encoding == "protobuf":
        return _protobuf(channel)
    if channel.encoding == "cdr":
        return _cdr(type_name)
    if channel.encoding == "json":
        return unpack_json
    raise ContentError(
        f"encoding {channel.encoding!r} is not understood; protobuf, cdr and json are"
    )


def _protobuf(channel: Channel) -> Unpack:
    schema = channel.schema
    if schema is None:
        raise ContentError("it has no schema")
    stock = McapSchema(schema.id, schema.data, schema.encoding, schema.name)
    try:
        decode = DecoderFactory().decoder_for("protobuf", stock)
    except (
        Exception
    ) as error:  # a damaged descriptor fails in many ways inside the protobuf runtime
        raise ContentError(f"its protobuf schema is damaged ({error})") from error
    if decode is None:
        raise ContentError(f"its schema is in {schema.encoding!r}, not protobuf")

    def unpack(content: memoryview) -> Unpacked:
        message = decode(bytes(content))
        data = getattr(message, "data", b"")
        return message, memoryview(data) if isinstance(data, bytes) else _NOTHING

    return unpack


@cache
def _typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_VIDEO_FIELDS, "foxglove_msgs/msg/CompressedVideo"))
    return store


def _cdr(type_name: str) -> Unpack:
    store = _typestore()
    if type_name not in store.fielddefs:
        raise ContentError(f"type {type_name} is not understood in CDR")

    def unpack(content: memoryview) -> Unpacked:
        message: Any = store.deserialize_cdr(content, type_name)
        data = getattr(message, "data", None)
        return message, _NOTHING if data is None else memoryview(data)

    return unpack


def unpack_json(content: memoryview) -> Unpacked:
    """A JSON message; its `data` is base64, with line breaks or without, in either alphabet, or a list of bytes.

    Raises ValueError where it is no object. `fields` checks what the values are.
    """
    message = json.loads(bytes(content), object_hook=lambda fields: SimpleNamespace(**fields))
    if not isinstance(message, SimpleNamespace):
        raise ValueError("a JSON message that is no object")
    data = getattr(message, "data", None)
    if isinstance(data, str):
        text = "".join(data.split()).translate(_STANDARD_ALPHABET)
        return message, memoryview(base64.b64decode(text + "=" * (-len(text) % 4), validate=True))
    return message, memoryview(bytes(data)) if isinstance(data, list) else _NOTHING
