"""The vector by which all panels of one drive differ from those of another: another datum, another base station.

No receiver states such an error, so what it states does not bound the vector. A vector counts where more supports agree
on it, to within the errors of their own panels, than chance makes. Only panels without a like nearby have a say: in a
row of equal ones many vectors fit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, gammainc

from wayside.schemas.detections import Rows
from wayside.schemas.sightings import Flags, Floats, Ints, Sightings
from wayside.stages.inventory.association import (
    NEAR_SIGMAS,
    SAME_PROBABILITY,
    face_log_ratio,
    facing_pairs,
    responsibilities,
)

VECTOR_REACH_M = (15.0, 30.0)
"""Longest vectors between two drives that are looked for, one after the other: datums and base stations."""
VECTOR_BY_CHANCE = 1e-3
"""Chance makes as many supports agree with less than this probability: about five supports."""

_TRIED = 64
"""Differences of two drives that are tried as their vector: one that many supports share is among them."""


@dataclass(frozen=True, slots=True)
class Differences(Rows):
    """Pairs of sightings that may be of one panel; m rows. The second less the first, east, north, up."""

    drive: Ints
    """The lower first, (m, 2)."""
    support: Ints
    """Assembly of the first, (m,)."""
    alone_m: Floats
    """Longest of `VECTOR_REACH_M` within which no other pair of these drives holds one of the two, 0: none, (m,)."""
    apart_m: Floats
    """(m, 3)."""
    own: Floats
    """Variances by the errors of the panels relative to the cameras nearby, (m, 3)."""
    stated: Floats
    """Variances by the errors common to neighbouring panels, (m, 3)."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """What the panels of two drives agree on: the second less the first, east, north, up."""

    vector_m: Floats
    """Zero where the errors that both state explain it, (3,)."""
    sigma_m: Floats
    """(3,)."""
    supports: int
    """How many agree."""
    clear: bool = True
    """False where only equal panels that are next to one another do."""

    def __str__(self) -> str:
        """The vector for a person."""
        axes = zip(self.vector_m, self.sigma_m, ("east", "north", "up"), strict=True)
        words = ", ".join(f"{round(v, 2) + 0.0:+.2f} ± {s:.2f} m {axis}" for v, s, axis in axes)
        return f"{words}, as {self.supports} supports agree"


def measure_differences(sightings: Sightings, counted: Flags) -> Differences:
    """Pairs of rows with one face that look the same way, within `VECTOR_REACH_M`; counted (n,) of the first."""
    i, j = facing_pairs(sightings, sightings.position, max(VECTOR_REACH_M)).T
    same = face_log_ratio(sightings, i, j) > 0
    i, j = i[same], j[same]
    apart = sightings.position[j] - sightings.position[i]
    alone = np.zeros(len(i))
    for reach in VECTOR_REACH_M:
        near = np.flatnonzero(np.hypot(*apart.T[:2]) <= reach)
        share = responsibilities(sightings, i[near], j[near], np.zeros(len(near)))
        alone[near[share == 1]] = reach
    own = sightings.covariance[:, [0, 1, 2], [0, 1, 2]]
    stated = np.square(sightings.common_sigma_m)[:, [0, 0, 1]]
    return Differences(
        np.column_stack([sightings.drive[i], sightings.drive[j]]),
        sightings.assembly[i],
        alone,
        apart,
        own[i] + own[j],
        stated[i] + stated[j],
    ).select(counted[i])


def agreement_of(pairs: Differences) -> Agreement | None:
    """What two drives agree on, from all pairs of these two; None where chance may make it.

    First to within the errors of the panels alone, as common errors hardly change along a short drive; else to within
    all stated errors. First within a short reach, where most panels have no like; else within a longer one.
    """
    length = np.hypot(*pairs.apart_m.T[:2])
    for reach in VECTOR_REACH_M:
        alone = pairs.select((length <= reach) & (pairs.alone_m >= reach))
        if (found := _agreement(alone, reach)) is not None:
            return found
    found = _agreement(pairs, max(VECTOR_REACH_M))
    return None if found is None or not found.vector_m.any() else replace(found, clear=False)


def _agreement(pairs: Differences, reach_m: float) -> Agreement | None:
    """What most supports agree on, to within the errors of their panels or all stated errors."""
    if not len(pairs.apart_m):
        return None
    found = _consensus(pairs, pairs.own, reach_m)
    return found or _consensus(pairs, pairs.own + pairs.stated, reach_m)


def _consensus(pairs: Differences, spread: Floats, reach_m: float) -> Agreement | None:
    """What most supports agree on to within variances (m, 3).

    Supports are counted, as panels on one support move together. Chance puts differences anywhere along the reach. As
    chance count the supports that agree without any vector, too, so that a few panels that were moved are no vector.
    """
    gate, nearest2 = float(chdtri(3, 1 - SAME_PROBABILITY)), NEAR_SIGMAS**2
    apart, total, count = pairs.apart_m, pairs.own + pairs.stated, len(spread)
    tried = np.arange(0, count, max(1, count // _TRIED))
    agree = _distance2(apart - apart[tried, None], spread + spread[tried, None]) < gate
    best = agree[np.argmax(_count_supports(agree, pairs.support))]
    near = _distance2(apart - _mean(apart, spread, best), total) < gate
    vector, stated = _mean(apart, total, near | best), pairs.stated[near | best].mean(axis=0)
    is_zero = bool(_distance2(vector, stated) < nearest2)
    unmoved = 0
    if not is_zero:
        within = _distance2(apart[tried], total[tried]) < nearest2
        others = agree[within] & ~np.isin(pairs.support, pairs.support[near])
        unmoved = int(_count_supports(others, pairs.support).max(initial=0))
    supports = int(_count_supports(best[None], pairs.support)[0])
    width_m = float(np.sqrt(gate * spread[best][:, :2].mean()))
    by_chance = count * width_m / reach_m + unmoved
    if count * gammainc(supports - 1, by_chance) > VECTOR_BY_CHANCE:
        return None
    sigma = np.sqrt(stated + 1 / (1 / pairs.own[best]).sum(axis=0))
    return Agreement(vector * (not is_zero), sigma, supports)


def reference_vectors(
    found: Mapping[tuple[int, int], Agreement], first_ns: Mapping[int, int]
) -> dict[int, tuple[int, Agreement]]:
    """The reference of each drive that differs, and how: of those connected the most that agree, or the earliest.

    `found`: by two drives, the lower first. `first_ns`: by drive, when it saw its first panel.
    """
    clear = {pair: one for pair, one in found.items() if one.clear}
    order = sorted(clear, key=lambda pair: (-clear[pair].supports, pair))
    alike = {drive: {drive} for pair in order for drive in pair}
    for a, b in order:
        if not clear[a, b].vector_m.any() and alike[a] is not alike[b]:
            alike[a] |= alike[b]
            alike |= dict.fromkeys(alike[b], alike[a])
    placed: dict[int, tuple[int, Agreement]] = {}
    none = Agreement(np.zeros(3), np.zeros(3), 0)
    for drive in sorted(alike, key=lambda drive: (-len(alike[drive]), first_ns[drive], drive)):
        if drive not in placed:
            placed |= dict.fromkeys(alike[drive], (drive, none))
        while joining := [pair for pair in order if (pair[0] in placed) != (pair[1] in placed)]:
            one, (known, other) = clear[joining[0]], joining[0]
            sign = 1.0
            if other in placed:
                known, other, sign = other, known, -1.0
            reference, before = placed[known]
            vector = before.vector_m + sign * one.vector_m
            placed |= dict.fromkeys(alike[other], (reference, replace(one, vector_m=vector)))
    return {drive: told for drive, told in placed.items() if told[1].vector_m.any()}


def _count_supports(rows: Flags, support: Ints) -> Ints:
    """Number of different supports (t,) among the pairs that each of rows (t, m) holds; support (m,)."""
    order = np.argsort(support, kind="stable")
    first = np.unique(support[order], return_index=True)[1]
    return np.asarray(np.logical_or.reduceat(rows[:, order], first, axis=1).sum(axis=1), np.int64)


def _mean(values: Floats, variance: Floats, rows: Flags) -> Floats:
    """Mean (3,) of some rows of values (m, 3) by the inverse of their variances."""
    return np.asarray(np.average(values[rows], axis=0, weights=1 / variance[rows]), np.float64)


def _distance2(apart: Floats, variance: Floats) -> Floats:
    """Squared Mahalanobis distances (...,) of differences (..., 3)."""
    return np.asarray((np.square(apart) / variance).sum(axis=-1), np.float64)
