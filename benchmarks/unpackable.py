"""How much of a compressed chunk its format lets be had of its first bytes: what salvage is measured against.

Written from the format descriptions and apart from what is measured. LZ4 frame and block format:
https://github.com/lz4/lz4/tree/dev/doc. Zstandard: RFC 8878. A compressed Zstandard block holds its sequences in a
bitstream that is read from the end, so that nothing of a block can be had without its last byte.
"""

from __future__ import annotations

import lz4.block
import numpy as np
import zstandard
from numpy.typing import NDArray

Reach = NDArray[np.int64]
"""Unpacked bytes that can be had of the first n packed ones, at n."""


def reach_of(compression: str, packed: bytes) -> Reach:
    """Reach of a whole chunk, (len(packed) + 1,)."""
    if compression == "lz4":
        return _lz4(packed)
    if compression == "zstd":
        return _zstd(packed)
    return np.arange(len(packed) + 1)


def _lz4(packed: bytes) -> Reach:
    reach, done = np.zeros(len(packed) + 1, np.int64), b""
    flags = packed[4]
    at = 7 + 8 * (flags >> 3 & 1) + 4 * (flags & 1)
    while size := int.from_bytes(packed[at : at + 4], "little"):
        block = packed[at + 4 : at + 4 + (size & 0x7FFFFFFF)]
        if not size >> 31:
            before = b"" if flags & 0x20 else done[-(1 << 16) :]
            block = lz4.block.decompress(block, uncompressed_size=1 << 22, dict=before)
        at += 4 + (size & 0x7FFFFFFF) + 4 * (flags >> 4 & 1)
        done += block
        reach[at] = len(done)
    return np.asarray(np.maximum.accumulate(reach))


def _zstd(packed: bytes) -> Reach:
    reach, done = np.zeros(len(packed) + 1, np.int64), 0
    flags = packed[4]
    single, sizes = flags >> 5 & 1, (flags >> 6 and 1 << (flags >> 6)) or flags >> 5 & 1
    at = 5 + (1 - single) + (0, 1, 2, 4)[flags & 3] + sizes
    frame = packed[:4] + bytes([0, 17 << 3])  # a window of 128 MB, no size, no checksum
    last = 0
    while not last:
        head = int.from_bytes(packed[at : at + 3], "little")
        last, kind, size = head & 1, head >> 1 & 3, head >> 3
        stored = 1 if kind == 1 else size
        begin, end = at + 3, at + 3 + stored
        whole = frame + (head | 1).to_bytes(3, "little") + packed[begin:end]
        frame += (head & ~1).to_bytes(3, "little") + packed[begin:end]
        unpacker = zstandard.ZstdDecompressor(max_window_size=1 << 27)
        done = len(unpacker.decompressobj().decompress(whole))
        reach[end] = done
        at = end
    return np.asarray(np.maximum.accumulate(reach))
