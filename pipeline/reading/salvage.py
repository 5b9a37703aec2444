"""What can be had of a chunk that is not whole: its front, up to where it is cut or can no longer be unpacked.

LZ4: https://github.com/lz4/lz4/blob/dev/doc/lz4_Frame_format.md and lz4_Block_format.md. A block of LZ4 is unpacked up
to its cut. Zstandard: RFC 8878. Its blocks of at most 128 kB are read from their ends, so a cut block gives nothing,
unless it is stored as it is, as JPEG mostly is.
"""

from __future__ import annotations

import lz4.block  # type: ignore[import-untyped]
import zstandard

from wayside.pipeline.reading.chunks import ChunkHead, zstd_unpacker

_PIECE = 1 << 8
"""Packed bytes that are unpacked at once: four of them may hold a block of zstd, 128 kB of one value."""
_LZ4_MAGIC = b"\x04\x22\x4d\x18"
_LZ4_BLOCKS = {4: 1 << 16, 5: 1 << 18, 6: 1 << 20, 7: 1 << 22}
_LZ4_REACH = 1 << 16
_LZ4_SHORTEST_MATCH = 4
_NOT_PACKED = 1 << 31
_ZSTD_SHORTEST, _ZSTD_HEAD = 8, 3  # bytes: of a frame with anything in it, before a block
_ZSTD_STORED, _ZSTD_REPEATED = 0, 1


def unpack_front(head: ChunkHead, packed: memoryview, most: int) -> memoryview:
    """The first bytes that a chunk holds, as many as can be unpacked, at most `most`; nothing of them is checked.

    Parameters
    ----------
    head
        Head of the chunk.
    packed
        What there is of its records, packed; the end may be missing or damaged.
    most
        Largest number of bytes to give.
    """
    most = min(most, head.unpacked_size)
    if head.compression in ("", "none"):
        return packed[:most]
    unpack = {"lz4": _lz4_front, "zstd": _zstd_front}.get(head.compression)
    return memoryview(b"" if unpack is None else unpack(packed, most))


def _zstd_front(packed: memoryview, most: int) -> bytearray:
    packed, front = _with_stored_front(packed), bytearray()
    unpacker = zstd_unpacker().decompressobj(read_across_frames=True)
    try:
        for start in range(0, len(packed), _PIECE):
            front += unpacker.decompress(packed[start : start + _PIECE])
            if len(front) >= most:
                break
    except (zstandard.ZstdError, MemoryError):
        pass  # what came before the fault is kept
    del front[most:]
    return front


def _with_stored_front(packed: memoryview) -> memoryview:
    """The same, where its last block is stored and cut off with that block as long as what there is of it."""
    if len(packed) < _ZSTD_SHORTEST:
        return packed
    flags = packed[4]
    single, size_code = flags >> 5 & 1, flags >> 6
    position = 6 - single + (0, 1, 2, 4)[flags & 3] + (1 << size_code if size_code else single)
    while position + _ZSTD_HEAD < len(packed):
        head = int.from_bytes(packed[position : position + _ZSTD_HEAD], "little")
        last, kind, size = head & 1, head >> 1 & 3, head >> 3
        begin = position + _ZSTD_HEAD
        end = begin + (1 if kind == _ZSTD_REPEATED else size)
        if end > len(packed) and kind == _ZSTD_STORED:
            shorter = (len(packed) - begin << 3).to_bytes(_ZSTD_HEAD, "little")
            return memoryview(b"".join((packed[:position], shorter, packed[begin:])))
        if last:
            break
        position = end
    return packed


def _lz4_front(packed: memoryview, most: int) -> bytearray:
    front = bytearray()
    if bytes(packed[:4]) != _LZ4_MAGIC or len(packed) < 7:
        return front
    flags, largest = packed[4], _LZ4_BLOCKS.get(packed[5] >> 4 & 7, 0)
    linked, block_checksums = not flags & 0x20, bool(flags & 0x10)
    position = 7 + (8 if flags & 0x08 else 0) + (4 if flags & 0x01 else 0)
    while position + 4 < len(packed) and len(front) < most:
        size = int.from_bytes(packed[position : position + 4], "little")
        stored, size = bool(size & _NOT_PACKED), size & (_NOT_PACKED - 1)
        if size == 0 or size > largest:
            break
        position += 4
        block = packed[position : position + size]
        position += size + (4 if block_checksums else 0)
        if stored:
            front += block
            continue
        before = bytes(front[-_LZ4_REACH:]) if linked else b""
        try:
            if len(block) < size:
                raise lz4.block.LZ4BlockError("cut off")
            front += lz4.block.decompress(block, uncompressed_size=largest, dict=before)
        except (lz4.block.LZ4BlockError, MemoryError):
            front += front_of_lz4_block(bytes(block), before, min(largest, most - len(front)))
            break
    del front[most:]
    return front


def front_of_lz4_block(block: bytes, before: bytes, most: int) -> bytes:
    """What a block of LZ4 holds up to its cut, or to the first sequence that cannot be; at most `most` bytes.

    block: the packed bytes that there are; before: up to 64 kB unpacked before it, to which its matches may reach.
    """
    out = bytearray(before)
    end = len(before) + most
    position = 0
    try:
        while len(out) < end:
            token = block[position]
            count, position = _lz4_length(block, position + 1, token >> 4)
            out += block[position : position + count]
            position += count
            back = block[position] | block[position + 1] << 8
            count, position = _lz4_length(block, position + 2, token & 15)
            if not 0 < back <= len(out):
                break
            count = min(count + _LZ4_SHORTEST_MATCH, end - len(out))
            repeated = bytes(out[len(out) - back :])
            out += (repeated * (count // back + 1))[:count]
    except IndexError:
        pass  # the cut
    return bytes(out[len(before) : end])


def _lz4_length(block: bytes, position: int, length: int) -> tuple[int, int]:
    """A length whose first four bits are given, continued by bytes where all are set; and the position behind it."""
    if length == 15:
        while True:
            byte = block[position]
            position, length = position + 1, length + byte
            if byte < 255:
                break
    return length, position
