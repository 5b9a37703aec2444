"""Which positions of a series a vehicle cannot have been at, told from the series before anything is built on it.

Two principles. A vehicle has a largest speed: the longest part of the series whose positions can be reached from each
other is kept, what cannot be reached from it is wrong (or, where the whole series moves elsewhere and stays, a new
origin). A vehicle has a largest acceleration: one or a few positions aside of a path that goes on as before are wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.pipeline.reading.stamps import Flags, Floats, Integers
from wayside.schemas.frame import EARTH_RADIUS_M, median_longitude_deg, turn_deg
from wayside.schemas.settings import ReadSettings

_LOOK_BACK = 256
"""Parts of a series before each that it may continue: bounds the time of a series that is nothing but jumps."""


@dataclass(frozen=True, slots=True)
class Series:
    """Positions over time: time_s (n,) ascending, position (n, 3) in metres, quaternion (n, 4) or None."""

    time_s: Floats
    position: Floats
    rotation: Floats | None


@dataclass(frozen=True, slots=True)
class PositionCheck:
    """What of a series is kept.

    wrong (n,): positions to be left out. origin (n,): number of the coordinate frame that each is given in, 0 for the
    frame of most; a position of another frame says nothing of the distance to those of this one.
    """

    wrong: Flags
    origin: Integers


def fix_positions(degrees: Floats) -> Floats:
    """East, north, up (n, 3) on a sphere about the median, of latitude, longitude (deg) and height (m)."""
    if not len(degrees):
        return degrees
    latitude, longitude = np.median(degrees[:, 0]), median_longitude_deg(degrees[:, 1])
    east = (
        np.radians(turn_deg(longitude, degrees[:, 1]))
        * np.cos(np.radians(latitude))
        * EARTH_RADIUS_M
    )
    north = np.radians(degrees[:, 0] - latitude) * EARTH_RADIUS_M
    return np.stack([east, north, degrees[:, 2]], axis=1)


def check_positions(
    series: Series, settings: ReadSettings, *, origin_may_move: bool
) -> PositionCheck:
    """Positions that are wrong, and those that another origin explains.

    Parameters
    ----------
    series
        As measured.
    settings
        What a vehicle can do.
    origin_may_move
        Whether the series is of a frame that can be set anew (poses, odometry) and not of the earth (fixes).
    """
    count = len(series.time_s)
    wrong, origin = np.zeros(count, np.bool_), np.zeros(count, np.int64)
    left = np.arange(count)
    if origin_may_move:  # else a sound position beside a wrong one may seem out of reach
        left = left[~_spikes(series, left, settings)]
    best = _reachable(series, left, settings)
    wrong[:] = True
    wrong[best] = False
    if origin_may_move and len(best):
        for side in (left[left < best[0]], left[left > best[-1]]):
            number = int(origin.max()) + 1
            for part in _parts(series, side, settings):
                if len(part) > settings.spike_samples:
                    wrong[part], origin[part] = False, number
                    number += 1
    if origin_may_move:
        for number in np.unique(origin[~wrong]):
            rows = np.flatnonzero(~wrong & (origin == number))
            wrong[rows[_spikes(series, rows, settings)]] = True
    return PositionCheck(wrong, origin)


def _distance(series: Series, a: Integers, b: Integers) -> Floats:
    """Distance (k,) from the positions a (k,) to b (k,), metres."""
    return np.asarray(np.linalg.norm(series.position[b] - series.position[a], axis=-1))


def _possible(series: Series, a: Integers, b: Integers, settings: ReadSettings) -> Flags:
    """Whether a vehicle can go from the positions a (k,) to b (k,)."""
    length = _distance(series, a, b)
    passed = np.abs(series.time_s[b] - series.time_s[a])
    return np.asarray(length <= settings.fastest_mps * passed + settings.position_slack_m)


def _parts(series: Series, rows: Integers, settings: ReadSettings) -> list[Integers]:
    """Rows (n,) cut wherever the next position cannot be reached."""
    if not len(rows):
        return []
    cuts = np.flatnonzero(~_possible(series, rows[:-1], rows[1:], settings)) + 1
    return np.split(rows, cuts)


def _reachable(series: Series, rows: Integers, settings: ReadSettings) -> Integers:
    """The most rows that can be reached one from the other; of as many, the shortest path."""
    parts = _parts(series, rows, settings)
    if len(parts) < 2:
        return rows
    # A wrong position may be in reach of those on one side: each next to a cut may be left out by itself.
    cuts = np.cumsum([len(part) for part in parts])[:-1]
    near = cuts[:, None] + np.arange(-settings.spike_samples, settings.spike_samples + 1)
    cuts = np.unique(near[(near > 0) & (near < len(rows))])
    parts = np.split(rows, cuts)
    first, last = (np.array([part[k] for part in parts]) for k in (0, -1))
    size, before = np.array([len(part) for part in parts]), np.full(len(parts), -1)
    length = np.array([_distance(series, part[:-1], part[1:]).sum() for part in parts])
    for k in range(1, len(parts)):
        earlier = np.arange(max(0, k - _LOOK_BACK), k)
        fits = earlier[_possible(series, last[earlier], np.full(len(earlier), first[k]), settings)]
        if len(fits):
            longest = fits[size[fits] == size[fits].max()]
            across = length[longest] + _distance(
                series, last[longest], np.full(len(longest), first[k])
            )
            shortest = int(np.argmin(across))
            before[k] = longest[shortest]
            size[k] += size[before[k]]
            length[k] += across[shortest]
    chosen, k = [], int(np.lexsort((length, -size))[0])
    while k >= 0:
        chosen.append(parts[k])
        k = int(before[k])
    return np.concatenate(chosen[::-1])


def _spikes(series: Series, rows: Integers, settings: ReadSettings) -> Flags:
    """Which of rows (n,) lie aside of a path that goes on behind them as before, one or a few in a row."""
    spikes = np.zeros(len(rows), np.bool_)
    scale = _scatter(series, rows)
    for length in range(1, settings.spike_samples + 1):
        kept = np.flatnonzero(~spikes)
        if len(kept) < length + 4:
            break
        found = _spikes_of(series, rows[kept], length, scale, settings)
        spikes[kept[found]] = True
    return spikes


def _spikes_of(
    series: Series, rows: Integers, length: int, scale: float, settings: ReadSettings
) -> Flags:
    """Spikes of a given length, each between two positions before and two after it that agree; the clearest first."""
    starts = np.arange(2, len(rows) - length - 1)
    a2, a1, b1, b2 = (rows[starts + k] for k in (-2, -1, length, length + 1))
    t, p = series.time_s, series.position
    scatter = settings.spike_scatters * scale
    span = t[b1] - t[a1]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = (p[b1] - p[a1]) / span[:, None]
        before = (p[a1] - p[a2]) / (t[a1] - t[a2])[:, None]
        after = (p[b2] - p[b1]) / (t[b2] - t[b1])[:, None]
        change = np.linalg.norm(across - (before + after) / 2, axis=1)
        gap = change * span
        # A steady acceleration leaves no gap at all; half of the hardest may come or go meanwhile.
        goes_on = gap <= settings.hardest_mps2 * span**2 / 4 + scatter
        aside, nearest = np.ones(len(starts), np.bool_), np.full(len(starts), np.inf)
        turned = np.ones(len(starts), np.bool_)
        for k in range(length):
            row = rows[starts + k]
            part = (t[row] - t[a1]) / span
            off = np.linalg.norm(p[row] - p[a1] - (p[b1] - p[a1]) * part[:, None], axis=1)
            sagitta = settings.hardest_mps2 * (t[row] - t[a1]) * (t[b1] - t[row]) / 2
            aside &= off > settings.spike_m + sagitta + scatter
            nearest = np.minimum(nearest, off)
            turned &= _turned(series, a1, row, b1, settings)
    found = np.zeros(len(rows), np.bool_)
    chosen = goes_on & (aside | turned)
    for start in starts[chosen][np.argsort(gap[chosen] - nearest[chosen], kind="stable")].tolist():
        if not found[start - 2 : start + length + 2].any():
            found[start : start + length] = True
    return found


def _turned(
    series: Series, a: Integers, row: Integers, b: Integers, settings: ReadSettings
) -> Flags:
    """Whether rotations differ from those before and after by more than a vehicle turns, and these agree."""
    if series.rotation is None:
        return np.zeros(len(row), np.bool_)
    q = series.rotation / np.linalg.norm(series.rotation, axis=1, keepdims=True)
    t = series.time_s

    def angle(first: Integers, second: Integers) -> Floats:
        cosine = np.abs((q[first] * q[second]).sum(axis=1))
        return np.asarray(2 * np.arccos(np.minimum(cosine, 1.0)))

    def most(first: Integers, second: Integers) -> Floats:
        rate = np.radians(settings.fastest_turn_dps)
        return np.asarray(rate * np.abs(t[second] - t[first]) + np.radians(settings.spike_deg))

    return np.asarray(
        (angle(a, row) > most(a, row))
        & (angle(row, b) > most(row, b))
        & (angle(a, b) <= most(a, b))
    )


def _scatter(series: Series, rows: Integers) -> float:
    """Robust standard deviation of the positions against the line between their neighbours, metres."""
    if len(rows) < 5:
        return 0.0
    p, t = series.position[rows], series.time_s[rows]
    span = np.maximum(t[2:] - t[:-2], 1e-9)
    part = (t[1:-1] - t[:-2]) / span
    off = np.linalg.norm(p[1:-1] - p[:-2] - (p[2:] - p[:-2]) * part[:, None], axis=1)
    return 1.48 * float(np.median(off))


def joined(series: Series, checked: PositionCheck) -> dict[int, tuple[Floats, Floats]]:
    """Rotation (3, 3) and shift (3,) that bring the positions of each other origin into the frame of origin 0.

    Where the origin moves, the vehicle keeps the speed and rate of turn that it had before; origin 0 is the log's.
    """
    moves: dict[int, tuple[Floats, Floats]] = {0: (np.eye(3), np.zeros(3))}
    kept = np.flatnonzero(~checked.wrong)
    origin = checked.origin[kept]
    order = [int(number) for number in dict.fromkeys(origin.tolist())]
    zero = order.index(0)
    for side in (range(zero + 1, len(order)), range(zero - 1, -1, -1)):
        for k in side:
            later = k > zero
            near = kept[origin == order[k - 1 if later else k + 1]]
            far = kept[origin == order[k]]
            pair = near[-2:] if later else near[:2][::-1]
            target = far[0] if later else far[-1]
            moves[order[k]] = _join(
                series, pair, int(target), moves[order[k - 1 if later else k + 1]]
            )
    return moves


def _join(
    series: Series, pair: Integers, target: int, known: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """The motion between a pair of rows carried on to the time of a third, as the move of that third."""
    assert series.rotation is not None
    rotation = Rotation.from_quat(series.rotation)
    turn, shift = Rotation.from_matrix(known[0]), known[1]
    base, t = int(pair[-1]), series.time_s
    position = turn.apply(series.position[base]) + shift
    expected_rotation, expected = turn * rotation[base], position
    if len(pair) > 1:
        step = rotation[int(pair[0])].inv() * rotation[base]
        passed = t[base] - t[int(pair[0])]
        part = (t[target] - t[base]) / passed if passed else 0.0
        displacement = turn.apply(series.position[base] - series.position[int(pair[0])])
        expected = position + displacement * part
        expected_rotation = expected_rotation * Rotation.from_rotvec(step.as_rotvec() * part)
    move = expected_rotation * rotation[target].inv()
    return move.as_matrix(), expected - move.apply(series.position[target])
