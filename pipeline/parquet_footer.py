"""What the footer of a Parquet file states of its columns, read without Arrow.

Arrow 26 ends the process where the statistics of a column contradict its schema and the metadata of that column is
asked for from Python. The footer is in the compact protocol of Thrift
(https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md); numbers of fields are those of
parquet.thrift (https://github.com/apache/parquet-format).
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from typing import Any, BinaryIO

import pyarrow as pa

from wayside.pipeline.json_text import CONTENT_FAULTS

_TAIL = struct.Struct("<I4s")  # length of the footer, and which kind of file it is
_MAGIC = b"PAR1"
_TRUE, _FALSE, _DOUBLE, _TEXT, _LIST, _SET, _MAP, _STRUCT = 1, 2, 7, 8, 9, 10, 11, 12
_INTEGERS = (3, 4, 5, 6)
_SCHEMA, _ROW_GROUPS = 2, 4
_LENGTH, _CHILDREN = 2, 5
_COLUMNS, _ROWS = 1, 3
_ABOUT = 3
_PATH, _VALUES, _UNPACKED = 3, 5, 6
_WIDTH = 8
"""Bytes of a value, as it is counted at least."""


@dataclass(frozen=True, slots=True)
class StatedColumn:
    """A column of a row group; `bytes`: what it unpacks to, or what its values take one by one where that is more."""

    name: str
    bytes: int


def stated_columns(stream: BinaryIO) -> list[StatedColumn]:
    """The columns of all row groups of a Parquet file, one after the other.

    Raises
    ------
    OSError
        It cannot be read.
    pa.ArrowInvalid
        It is no Parquet file, or its footer is damaged or encrypted.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - _TAIL.size, 0))
    try:
        length, magic = _TAIL.unpack(stream.read())
        if magic != _MAGIC or length > size - _TAIL.size:
            raise ValueError(magic)
        stream.seek(size - _TAIL.size - length)
        footer = _Reader(stream.read(length)).struct()
        leaves = [one for one in footer[_SCHEMA] if not one.get(_CHILDREN)]
        widths = [max(one.get(_LENGTH, 0), _WIDTH) for one in leaves]
        return [
            _stated(column[_ABOUT], width, group[_ROWS])
            for group in footer[_ROW_GROUPS]
            for column, width in zip(group[_COLUMNS], widths, strict=True)
        ]
    except (*CONTENT_FAULTS, struct.error, RecursionError) as error:
        raise pa.ArrowInvalid("no Parquet, or its footer is damaged") from error


def _stated(about: dict[int, Any], width: int, rows: int) -> StatedColumn:
    values = max(about[_VALUES], rows)
    return StatedColumn(about[_PATH][0].decode("utf-8"), max(about[_UNPACKED], width * values))


class _Reader:
    """Values of the compact protocol, one after the other: structs by number of field, lists, bytes and numbers."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def struct(self) -> dict[int, Any]:
        """Fields of a struct."""
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            number = number + step if step else self._integer()
            fields[number] = kind == _TRUE if kind in (_TRUE, _FALSE) else self._value(kind)
        return fields

    def _value(self, kind: int) -> Any:
        if kind in _INTEGERS:
            return self._byte() if kind == _INTEGERS[0] else self._integer()
        if kind == _TEXT:
            return self._bytes(self._varint())
        if kind == _STRUCT:
            return self.struct()
        if kind in (_LIST, _SET):
            head = self._byte()
            count = head >> 4 if head >> 4 < 15 else self._varint()
            return [self._element(head & 15) for _ in range(count)]
        if kind == _MAP:
            count = self._varint()
            kinds = self._byte() if count else 0
            return [(self._element(kinds >> 4), self._element(kinds & 15)) for _ in range(count)]
        if kind == _DOUBLE:
            return self._bytes(8)
        raise ValueError(f"a value of kind {kind}")

    def _element(self, kind: int) -> Any:
        return self._byte() if kind in (_TRUE, _FALSE) else self._value(kind)

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]

    def _bytes(self, count: int) -> bytes:
        self._at += count
        if self._at > len(self._data):
            raise IndexError
        return self._data[self._at - count : self._at]

    def _varint(self) -> int:
        value = shift = 0
        while (byte := self._byte()) & 0x80:
            value |= (byte & 0x7F) << shift
            shift += 7
            if shift > 63:
                raise ValueError("a number of over 64 bits")
        return value | byte << shift

    def _integer(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)
