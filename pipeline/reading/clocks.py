"""One time for every message of a log, whatever its clocks did, and the order that follows.

Log times say when a message was recorded, header times when it was measured. Either clock may be set while it runs, one
message may carry a wrong time, and messages may stand in the file in another order than they were recorded in. All
functions work on arrays in nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np

from wayside.pipeline.reading.layout import LATEST_NS
from wayside.pipeline.reading.stamps import Flags, Integers
from wayside.schemas.settings import ReadSettings


@dataclass(frozen=True, slots=True)
class LogClock:
    """The log's own clock made continuous.

    time_ns (n,): log time of each message; by_time: messages are in order by it and not by their place in the file;
    jumps: rows where the clock was set, and by how much (ns, negative: back); strays (n,): messages whose log time is
    far from all others.
    """

    time_ns: Integers
    by_time: bool
    jumps: tuple[tuple[int, int], ...]
    strays: Flags


@dataclass(frozen=True, slots=True)
class _Run:
    """Messages `begin` to before `end` of the file, between which the log time is continuous."""

    begin: int
    end: int
    first_ns: int
    last_ns: int


def settle_log(
    log_ns: Integers, images: Integers, capture_ns: Integers, settings: ReadSettings
) -> LogClock:
    """Log times in the order in which the messages were recorded.

    The file is a sequence of runs within which log times are continuous. Sorted by time, runs of a log whose parts
    changed places fit together, with fewer breaks than in the file and without overlap: then log times tell the order.
    Otherwise the place in the file tells it, and a run that begins earlier than the one before it ends was recorded
    after the clock was set: it is moved behind, so far that its first image follows the last one as far as the header
    times say, else at the usual distance.

    Parameters
    ----------
    log_ns
        (n,) in file order.
    images, capture_ns
        (k,) rows of images among the messages, and their header times, 0 where not set.
    settings
        Messages are at most `late_s` late, longer silences separate runs; a short run out of order `far_s` from all
        others holds stray messages.
    """
    window_ns = round(settings.late_s * 1e9)
    nothing = np.zeros(len(log_ns), np.bool_)
    runs = _runs(log_ns, window_ns)
    stray = _stray_runs(runs, settings)
    if not stray and _ascend(runs, window_ns):
        return LogClock(log_ns, False, (), nothing)
    bulk = [run for run in runs if run not in stray]
    by_time = _fits_by_time(bulk, window_ns)
    time_ns, strays = log_ns.copy(), nothing
    jumps: list[tuple[int, int]] = []
    shifts: list[tuple[int, int, int]] = []
    shift, end_ns, image = 0, None, -1
    usual = _usual_interval(log_ns, images)
    for run in runs:
        inside = images[(images >= run.begin) & (images < run.end)]
        rows = slice(run.begin, run.end)
        if run in stray:
            strays[rows] = True
            continue
        if end_ns is not None and not by_time:
            possible = [s for s in (shift, 0) if run.first_ns + s >= end_ns - window_ns]
            if possible:
                shift = min(possible, key=lambda s: run.first_ns + s)
            else:
                before = shift
                shift = end_ns - run.first_ns
                if image >= 0 and len(inside):
                    pair, farthest = (image, int(inside[0])), settings.jump_images * usual
                    shift = _across(
                        time_ns, log_ns, images, capture_ns, pair, usual, farthest, shift
                    )
                jumps.append((run.begin, before - shift))
        if max(2 * abs(shift), run.last_ns + shift) >= LATEST_NS:  # or sums exceed 64 bits
            stray.add(run)
            strays[rows], shift = True, 0
            continue
        shifts.append((run.end - run.begin, -run.begin, shift))
        time_ns[rows] += shift
        end_ns = run.last_ns + shift if end_ns is None else max(end_ns, run.last_ns + shift)
        image = int(inside[-1]) if len(inside) else image
    time_ns -= max(shifts, default=(0, 0, 0))[2]  # the longest run keeps its times
    _place_strays(time_ns, strays, [run for run in runs if run in stray], images, usual)
    return LogClock(time_ns, by_time, tuple(jumps), strays)


def _runs(log_ns: Integers, window_ns: int) -> list[_Run]:
    """Parts of the file in which no message is later or earlier than its predecessors by more than the window."""
    latest = np.maximum.accumulate(log_ns) if len(log_ns) else log_ns
    starts = [0] if len(log_ns) else []
    if len(log_ns) and (
        (log_ns[1:] < latest[:-1] - window_ns).any() or (np.diff(latest) > window_ns).any()
    ):
        newest = int(log_ns[0])
        for row, time in enumerate(log_ns.tolist()):
            if abs(time - newest) > window_ns:
                starts.append(row)
                newest = time
            newest = max(newest, time)
    ends = [*starts[1:], len(log_ns)]
    return [
        _Run(a, b, int(log_ns[a:b].min()), int(log_ns[a:b].max()))
        for a, b in zip(starts, ends, strict=True)
    ]


def _ascend(runs: list[_Run], window_ns: int) -> bool:
    return all(b.first_ns >= a.last_ns - window_ns for a, b in pairwise(runs))


def _fits_by_time(runs: list[_Run], window_ns: int) -> bool:
    """Whether runs sorted by time overlap nowhere and leave fewer breaks than there are in the file."""
    ordered = sorted(runs, key=lambda run: run.first_ns)
    gaps = [b.first_ns - a.last_ns for a, b in pairwise(ordered)]
    breaks = sum(abs(b.first_ns - a.last_ns) > window_ns for a, b in pairwise(runs))
    return all(gap >= -window_ns for gap in gaps) and sum(g > window_ns for g in gaps) < breaks


def _stray_runs(runs: list[_Run], settings: ReadSettings) -> set[_Run]:
    """Short runs far from all others which stand out of order, or still further at an end of the file; few messages."""
    if len(runs) < 2:
        return set()
    window_ns, far_ns = round(settings.late_s * 1e9), round(settings.far_s * 1e9)
    total = runs[-1].end
    ordered = sorted(runs, key=lambda run: run.first_ns)
    place = {run: k for k, run in enumerate(ordered)}
    gaps = [inf, *(b.first_ns - a.last_ns for a, b in pairwise(ordered)), inf]
    stray = set()
    for k, run in enumerate(runs):
        at = place[run]
        furthest = (
            far_ns
            if at != k
            else settings.stray_pauses * far_ns
            if k in (0, len(runs) - 1)
            else inf
        )
        if run.last_ns - run.first_ns <= window_ns and min(gaps[at], gaps[at + 1]) > furthest:
            stray.add(run)
    few = sum(run.end - run.begin for run in stray) <= settings.most_stray * total
    return stray if few else set()


def _usual_interval(log_ns: Integers, images: Integers) -> int:
    """Median time between images in nanoseconds."""
    apart = np.diff(log_ns[images])
    apart = apart[apart > 0]
    return int(np.median(apart)) if len(apart) else 0


def _across(
    time_ns: Integers,
    log_ns: Integers,
    images: Integers,
    capture_ns: Integers,
    pair: tuple[int, int],
    usual_ns: int,
    farthest_ns: float,
    least_ns: int,
) -> int:
    """Shift of the log times behind a jump, by the images (rows) on its two sides."""
    before, after = np.searchsorted(images, pair)
    apart = int(capture_ns[after] - capture_ns[before])
    known = capture_ns[before] > 0 and capture_ns[after] > 0
    if not (known and 0 < apart <= farthest_ns):
        return max(int(time_ns[pair[0]]) + usual_ns - int(log_ns[pair[1]]), least_ns)
    return int(time_ns[pair[0]]) + apart - int(log_ns[pair[1]])


def _place_strays(
    time_ns: Integers, strays: Flags, runs: list[_Run], images: Integers, usual_ns: int
) -> None:
    """Give each run of stray messages times by its place in the file.

    Its first image has the usual time from the next one, as far as its neighbours in the file allow.
    """
    is_image = np.zeros(len(time_ns), np.bool_)
    is_image[images] = True
    for run in runs:
        rows = slice(run.begin, run.end)
        inside = images[(images >= run.begin) & (images < run.end)]
        sound = np.flatnonzero(is_image & ~strays) if len(inside) else np.empty(0, np.int64)
        step = usual_ns if len(sound) else 0
        sound = sound if len(sound) else np.flatnonzero(~strays)
        anchor = int(inside[0]) if len(inside) else run.begin
        k = int(np.searchsorted(sound, anchor))
        if 0 < k < len(sound):
            placed = int(time_ns[sound[k - 1]] + time_ns[sound[k]]) // 2
        else:
            placed = int(time_ns[sound[0]]) - step if k == 0 else int(time_ns[sound[-1]]) + step
        others = np.flatnonzero(~strays)
        k = int(np.searchsorted(others, anchor))
        if k > 0:
            placed = max(placed, int(time_ns[others[k - 1]]))
        if k < len(others):
            placed = min(placed, int(time_ns[others[k]]))
        time_ns[rows] += placed - int(time_ns[anchor])


def settle_headers(
    log_ns: Integers, header_ns: Integers, window_ns: int
) -> tuple[Integers, Flags, int]:
    """Times of one stream by its headers, where these are sound.

    Header and log time advance alike, apart from messages that wait before they are recorded. Where a header goes back,
    or ahead of the log, by more than the window, its clock was set or the header is wrong: from there on log times
    give the time, with the stream's usual difference between both, until the headers agree again.

    Parameters
    ----------
    log_ns
        (n,) continuous log times, in order.
    header_ns
        (n,) header times, 0 where not set.
    window_ns
        Largest sound deviation.

    Returns
    -------
    tuple
        Time (n,) on the stream's own clock; whether (n,) the header was not used; its usual offset to the log's clock,
        0 for a stream without headers.
    """
    known = np.flatnonzero(header_ns > 0)
    if not len(known):
        return log_ns, np.zeros(len(log_ns), np.bool_), 0
    log, header = log_ns[known], header_ns[known]
    offset = header - log
    ahead, passed = np.diff(header), np.diff(log)
    jump = (np.abs(np.diff(offset)) > window_ns) & ((ahead < 0) | (ahead > passed + window_ns))
    part = np.concatenate([[0], np.cumsum(jump)])
    time_ns, wrong = log_ns.copy(), np.ones(len(log_ns), np.bool_)
    largest = int(np.argmax(np.bincount(part)))
    usual = int(np.median(offset[part == largest]))
    inside = np.abs(offset - usual) <= window_ns
    settled, unlike = header.copy(), np.zeros(len(known), np.bool_)
    for number in np.unique(part):
        rows = part == number
        level = int(np.median(offset[rows]))
        if number == largest or inside[rows].all() or abs(level - usual) <= window_ns:
            continue
        settled[rows] = settled[rows] - level + usual
        unlike[rows] = True
    time_ns += usual
    time_ns[known], wrong[known] = settled, unlike
    return time_ns, wrong, usual
