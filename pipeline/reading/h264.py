"""What the headers of an H.264 stream say about its pictures, read without decoding them.

Annex B byte stream, parameter sets and slice headers: ITU-T H.264, annex B and clauses 7.3.1, 7.3.2.1.1, 7.3.3.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

H264 = "h264"
"""Encoding of the images of a video, in Annex B form, one picture a message."""
_START = re.compile(b"\0\0\1")
_SLICE, _KEY_SLICE, _SEQUENCE_SET = 1, 5, 7
_HEAD_BYTES = 256
"""A sequence set or the start of a slice header is shorter, scaling lists included."""
_WITH_CHROMA = frozenset({44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244})
_B_SLICES = frozenset({1, 6})


class SequenceSet(NamedTuple):
    """Size of the pictures in pixels, cropped; numbers count modulo `modulus`, with gaps where `gaps`."""

    width: int
    height: int
    modulus: int
    gaps: bool
    separate_planes: bool


class PictureHead(NamedTuple):
    """First slice of a picture: needs no other (`key`), refers to later ones (`both_ways`), is referred to.

    `number`: `frame_num`, which rises by one after a picture that others refer to.
    """

    key: bool
    both_ways: bool
    referred: bool
    number: int


def read_stream(
    data: bytes | memoryview, known: SequenceSet | None
) -> tuple[SequenceSet | None, PictureHead | None]:
    """The sequence set in force and the first picture of a piece of stream, or None.

    `known`: the sequence set of the pieces before. Raises ValueError where headers make no sense.
    """
    sequence = known
    for unit in _units(data):
        kind, referred = unit[0] & 31, bool(unit[0] >> 5 & 3)
        if kind == _SEQUENCE_SET:
            sequence = _sequence_set(_Bits(unit[1:]))
        elif kind in (_SLICE, _KEY_SLICE) and sequence is not None:
            bits = _Bits(unit[1:])
            bits.unsigned()
            slice_type = bits.unsigned()
            bits.unsigned()
            bits.take(2 * sequence.separate_planes)
            number = bits.take(sequence.modulus.bit_length() - 1)
            return sequence, PictureHead(
                kind == _KEY_SLICE, slice_type in _B_SLICES, referred, number
            )
    return sequence, None


def _units(data: bytes | memoryview) -> Iterator[bytes]:
    """Starts of the units of a byte stream, without the bytes that keep start codes out of them."""
    content = bytes(data)
    for found in _START.finditer(content):
        unit = content[found.end() : found.end() + _HEAD_BYTES]
        if unit:
            yield unit.replace(b"\0\0\3", b"\0\0")


def _sequence_set(bits: "_Bits") -> SequenceSet:
    profile = bits.take(8)
    bits.take(16)
    bits.unsigned()
    chroma, separate = 1, False
    if profile in _WITH_CHROMA:
        chroma = bits.unsigned()
        separate = chroma == 3 and bool(bits.take(1))
        bits.unsigned()
        bits.unsigned()
        bits.take(1)
        if bits.take(1):
            for k in range(12 if chroma == 3 else 8):
                if bits.take(1):
                    _pass_scaling_list(bits, 16 if k < 6 else 64)
    modulus = 1 << bits.unsigned() + 4
    order = bits.unsigned()
    if order == 0:
        bits.unsigned()
    elif order == 1:
        bits.take(1)
        bits.unsigned()
        bits.unsigned()
        for _ in range(bits.unsigned()):
            bits.unsigned()
    bits.unsigned()
    gaps = bool(bits.take(1))
    columns, rows = bits.unsigned() + 1, bits.unsigned() + 1
    fields = 2 - bits.take(1)
    if fields == 2:
        bits.take(1)
    bits.take(1)
    width, height = 16 * columns, 16 * rows * fields
    if bits.take(1):
        across = 2 if chroma in (1, 2) and not separate else 1
        down = fields * (2 if chroma == 1 and not separate else 1)
        left, right, top, bottom = (bits.unsigned() for _ in range(4))
        width, height = width - across * (left + right), height - down * (top + bottom)
    if modulus > 1 << 16 or not (0 < width <= 1 << 16 and 0 < height <= 1 << 16):
        raise ValueError("an invalid sequence parameter set")
    return SequenceSet(width, height, modulus, gaps, separate)


def _pass_scaling_list(bits: "_Bits", size: int) -> None:
    last, following = 8, 8
    for _ in range(size):
        if following:
            code = bits.unsigned()
            following = (last + (code + 1 >> 1 if code & 1 else -(code >> 1))) % 256
        last = following or last


class _Bits:
    """Bits of a unit, first the highest of each byte."""

    def __init__(self, data: bytes) -> None:
        self._value, self._left = int.from_bytes(data, "big"), 8 * len(data)

    def take(self, count: int) -> int:
        """The next bits as a number; raises ValueError where the unit has none."""
        self._left -= count
        if self._left < 0:
            raise ValueError("a unit of the video that is cut off in its header")
        return self._value >> self._left & ((1 << count) - 1)

    def unsigned(self) -> int:
        """The next number in Exp-Golomb code, ue(v) of clause 9.1."""
        zeros = 0
        while not self.take(1):
            zeros += 1
            if zeros > 31:
                raise ValueError("a number in the video that is cut off")
        return (1 << zeros) - 1 + self.take(zeros)
