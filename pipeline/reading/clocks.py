"""When the messages of a log were measured, by header and log times, and which of them pair two streams.

Log times say when a message was recorded, header times when it was measured. For each stream the offset between the two
is estimated once. Header times pair two streams where their offsets agree, or differ by what messages wait before they
are recorded: their clock is the same. Otherwise log times pair them. All functions work on arrays in nanoseconds.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

_LATE_NS = 1_500_000_000
"""Largest delay of a valid message behind others of its clock: receivers report once a second."""
_APART_NS = 15_000_000_000
"""Images follow each other sooner, unless the vehicle stands or the clock was set."""
_COARSE_SHARE = 0.2
"""Share of neighbours with one time from which a clock is too coarse; a few are messages recorded twice."""
_UNITS_NS = (10**9, 10**8, 10**7, 10**6)
"""Times are rounded to seconds or to decimal parts of them."""
_SAME_RATE = 1.25
"""Header and log clock run alike up to this factor; a clock in other units is a thousand times off."""
_AGREE_SHARE = 0.1
"""Offsets agree within this share of the time between images: positions are then off by as much of their distance."""


@dataclass(frozen=True, slots=True)
class StreamTimes:
    """Times (n,) of the messages of one stream, in file order; `has_...`: whether they tell when it was measured.

    `header_ns`: where one is missing or off, the log time plus `offset_ns`, the median of header less log time (0
    without both). `off`: how many header times differ from log times by another offset.
    """

    log_ns: Integers
    header_ns: Integers
    has_header: bool
    has_log: bool
    offset_ns: int = 0
    off: int = 0

    @property
    def scatter_ns(self) -> float:
        """Median deviation of header less log time from its median."""
        offset = self.header_ns - self.log_ns
        return float(np.median(np.abs(offset - np.median(offset))))

    @property
    def capture_ns(self) -> Integers:
        """(n,) header times where they are sound, else log times."""
        return self.header_ns if self.has_header else self.log_ns


def stream_times(log_ns: Integers, header_ns: Integers) -> StreamTimes:
    """Judge the clocks of one stream.

    A clock is not used where it is not set, or where times of one topic go back and overlap. It is not used either
    where many messages share one time that the other clock distinguishes. Where a header differs from the usual offset,
    the time that is nearer to the others is right: header or log time. Both (n,) in file order; header 0 where not set.
    """
    known = np.flatnonzero(header_ns > 0)
    header, log = header_ns[known], log_ns[known]
    runs_on = not _overlaps(log_ns)
    if 2 * len(known) <= len(header_ns) or _is_coarse(header, log):
        return StreamTimes(log_ns, log_ns, False, runs_on)
    if not runs_on or _is_coarse(log, header) or not _run_alike(log, header):
        if _overlaps(header):
            return StreamTimes(log_ns, log_ns, False, False)
        filled = header_ns.copy()
        missing = np.flatnonzero(header_ns <= 0)
        filled[missing] = header[np.searchsorted(known, missing).clip(max=len(known) - 1)]
        return StreamTimes(log_ns, filled, True, False)
    offset = header - log
    usual = int(np.sort(offset)[len(offset) // 2])
    wrong = np.abs(offset - usual) > _LATE_NS
    first, last = int(header[~wrong].min()), int(header[~wrong].max())
    by_log = log_ns + usual
    settled, logged = by_log.copy(), by_log[known]
    outside = [np.abs(one - one.clip(first, last)) for one in (header, logged)]
    nearer = outside[0] <= outside[1]
    settled[known] = np.where(~wrong | nearer, header, logged)
    return StreamTimes(log_ns, settled, True, True, usual, int(wrong.sum()))


def _is_coarse(time_ns: Integers, other_ns: Integers) -> bool:
    """Whether many neighbours share one time but not by the other clock, or times are rounded and irregular."""
    order = np.lexsort((time_ns, other_ns))
    apart, others = np.diff(time_ns[order]), np.diff(other_ns[order])
    if not len(apart):
        return False
    if float(((apart == 0) & (others != 0)).mean()) > _COARSE_SHARE:
        return True
    unit = next((unit for unit in _UNITS_NS if not (time_ns % unit).any()), 1)
    irregular = (
        np.abs(apart - np.median(apart)).mean() > 2 * np.abs(others - np.median(others)).mean()
    )
    return bool(irregular and unit > _AGREE_SHARE * np.median(apart))


def _run_alike(log_ns: Integers, header_ns: Integers) -> bool:
    """Whether both clocks advance at the same rate."""
    order = np.argsort(header_ns, kind="stable")
    ahead, passed = np.diff(header_ns[order]), np.abs(np.diff(log_ns[order]))
    moved = (ahead > 0) & (passed > 0)
    if not moved.any():
        return True
    return 1 / _SAME_RATE < float(np.median(ahead[moved] / passed[moved])) < _SAME_RATE


def _overlaps(time_ns: Integers) -> bool:
    """Whether the times of one topic, in file order, go back into a span that was passed: their clock was set.

    Files may hold their messages in any order, in parts that follow each other in time. Parts that overlap cannot all
    be right.
    """
    latest = np.maximum.accumulate(time_ns)
    if not (time_ns[1:] < latest[:-1] - _LATE_NS).any():
        return False
    starts, newest = [0], int(time_ns[0])
    for row, time in enumerate(time_ns.tolist()):
        if abs(time - newest) > _LATE_NS:
            starts.append(row)
            newest = time
        newest = max(newest, time)
    parts = np.split(time_ns, starts[1:])
    spans = sorted((int(part.min()), int(part.max())) for part in parts)
    ends = np.maximum.accumulate([end for _, end in spans])
    return any(spans[k + 1][0] < ends[k] - _LATE_NS for k in range(len(spans) - 1))


def clock_set_at(time_ns: Integers) -> int:
    """Row of the first image that is much earlier than the one before it in the file; 0 if there is no such image.

    Parts of a file may stand in any order: sorted, their times follow each other without a gap, and that is no fault.
    """
    back = np.flatnonzero(np.diff(time_ns) < -_APART_NS)
    gaps = np.diff(np.sort(time_ns)) > _APART_NS
    return int(back[0]) + 1 if len(back) and gaps.any() else 0


class Pairing(NamedTuple):
    """Times of the images (k,) and of a stream's messages (n,) on one clock, by "header" or "log".

    `apart_ns`: by how much the stream's header clock is ahead of the images' clock; 0 where header times pair them.
    """

    images_ns: Integers
    stream_ns: Integers
    apart_ns: int
    by: str


def pair_times(
    images: StreamTimes, stream: StreamTimes, *, own_clock: bool = False
) -> Pairing | None:
    """Header times where they are of one clock, else log times; None where no clock is common to both.

    They are of one clock where their offsets agree. A stream without `own_clock` (satellite receivers have one) may
    also be recorded some time after it was measured, as a pose that is computed from an image. Log times that scatter
    by more than the offsets may differ pair nothing better.
    """
    headers = Pairing(images.header_ns, stream.header_ns, 0, "header")
    both_headers = images.has_header and stream.has_header
    both_logs = images.has_log and stream.has_log
    if not both_logs:
        return headers if both_headers else None
    logs = Pairing(images.log_ns, stream.log_ns, 0, "log")
    if not both_headers:
        return logs
    steps = np.diff(np.sort(images.capture_ns))
    steps = steps[steps > 0]
    slack = _AGREE_SHARE * float(np.median(steps)) if len(steps) else 0.0
    apart = _apart(images, stream)
    late = all(-_LATE_NS <= one.offset_ns <= slack for one in (images, stream))
    scatters = any(one.scatter_ns > slack for one in (images, stream))
    if abs(apart) <= slack or (late and (scatters or not own_clock)):
        return headers
    return logs._replace(apart_ns=apart)


def _apart(images: StreamTimes, stream: StreamTimes) -> int:
    """Offset of a stream less that of the images, each as it was at the time of an image."""
    order = np.argsort(stream.log_ns, kind="stable")
    offsets = (stream.header_ns - stream.log_ns)[order]
    place = np.searchsorted(stream.log_ns[order], images.log_ns).clip(max=len(order) - 1)
    return int(np.median(offsets[place] - (images.header_ns - images.log_ns)))
