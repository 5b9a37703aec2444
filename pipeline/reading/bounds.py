"""What reading a log may cost: how far it may unpack, and how many records it may have, for its size."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.pipeline.reading.layout import LARGEST_RECORD, LayoutError

UNPACKED_RATIO = 255
"""Unpacked bytes for each byte read: the most that lz4 can reach; only zstd of nearly constant data is ever refused."""

EXTRA_BYTES = 500_000
"""A log counts as longer by this: a short one may begin with images of one colour, which cost little."""


@dataclass(slots=True)
class Allowance:
    """Bytes and records that a log may still unpack to.

    With n bytes of a log read, chunks may unpack to `ratio` (n + `extra_bytes`) bytes and to n + `extra_bytes` records.
    The cost of any log is bounded by a multiple of its size and a constant, whatever the log states.
    """

    ratio: int = UNPACKED_RATIO
    extra_bytes: int = EXTRA_BYTES
    unpacked_bytes: int = 0
    records: int = 0

    def take_bytes(self, count: int, read: int) -> None:
        """Use up the unpacked size of a chunk when `read` bytes are read; raises LayoutError where less is left."""
        left = self.ratio * (read + self.extra_bytes) - self.unpacked_bytes
        if count > min(left, LARGEST_RECORD):
            raise LayoutError(
                f"it says it unpacks to {count} bytes: over {LARGEST_RECORD}, or with what came before more than "
                f"{self.ratio} times what was read of the log"
            )
        self.unpacked_bytes += count

    def records_left(self, read: int) -> int:
        """Records that may still come when `read` bytes of the log are read."""
        return read + self.extra_bytes - self.records

    def take_records(self, count: int, read: int) -> None:
        """Use up records, as `take_bytes`."""
        left = self.records_left(read)
        if count > left:
            raise LayoutError(
                f"it has over {left} records, with what came before more than the log has bytes"
            )
        self.records += count
