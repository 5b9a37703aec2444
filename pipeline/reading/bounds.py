"""What reading a log may cost: how far it may unpack, and how many records it may have, for its size."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.pipeline.reading.chunks import TooMuchError
from wayside.pipeline.reading.layout import LARGEST_RECORD
from wayside.schemas.settings import ReadSettings

_DEFAULTS = ReadSettings()


@dataclass(slots=True)
class Allowance:
    """Bytes and records that a log may still unpack to.

    Of a log of which n bytes were read, chunks may unpack to `ratio` (n + `extra_bytes`) bytes and to n + `extra_bytes`
    records: the cost of any log is bounded by a multiple of its size and a constant, whatever it says of itself.
    """

    ratio: float = _DEFAULTS.unpacked_ratio
    extra_bytes: int = int(_DEFAULTS.unpacked_extra_kb * 1000)
    unpacked_bytes: int = 0
    records: int = 0

    def take_bytes(self, count: int, read: int) -> None:
        """Use up the unpacked size of a chunk, before it is unpacked.

        Raises
        ------
        TooMuchError
            It is more than is left when `read` bytes of the log are read.
        """
        if count > LARGEST_RECORD:
            raise TooMuchError(
                f"it says it unpacks to {count} bytes; at most {LARGEST_RECORD} are unpacked"
            )
        if self.unpacked_bytes + count > self.ratio * (read + self.extra_bytes):
            raise TooMuchError(
                f"it says it unpacks to {count} bytes, with what came before more than {self.ratio:g} times what was "
                "read of the log; if this is right, raise the setting read.unpacked_ratio"
            )
        self.unpacked_bytes += count

    def records_left(self, read: int) -> int:
        """Records that may still come when `read` bytes of the log are read."""
        return read + self.extra_bytes - self.records


def allowance_of(settings: ReadSettings) -> Allowance:
    """The allowance that settings give."""
    return Allowance(settings.unpacked_ratio, int(settings.unpacked_extra_kb * 1000))
