"""The vector by which all panels of one drive stand off those of another: another datum, another base station.

No receiver states such an error, so what it states does not bound the vector. A vector counts where more supports agree
on it, to within the errors of their own panels, than chance and every other vector can make.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, poisson

from wayside.schemas.settings.merging import MergeSettings
from wayside.schemas.sightings import Sightings
from wayside.stages.inventory.association import face_log_ratio, facing_pairs

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
_TRIED = 64
"""Differences of two drives that are tried as their vector: one that many supports share is among them."""


@dataclass(frozen=True, slots=True)
class Differences:
    """Pairs of sightings that may be of one panel; m rows.

    drive (m, 2): the lower first; row (m, 2): in the drives' tables; support (m,): assembly of the first; apart_m
    (m, 3): second less first, east, north, up; own, stated (m, 3): variances of that, of the panels relative to the
    cameras nearby and of the errors common to neighbouring panels.
    """

    drive: Ints
    row: Ints
    support: Ints
    apart_m: Floats
    own: Floats
    stated: Floats

    def select(self, rows: Ints | Flags) -> Differences:
        """Some of the rows."""
        return Differences(*(getattr(self, f.name)[rows] for f in fields(self)))

    @staticmethod
    def joined(parts: Sequence[Differences]) -> Differences:
        """The rows of several, one after the other; at least one."""
        columns = ([getattr(part, f.name) for part in parts] for f in fields(Differences))
        return Differences(*(np.concatenate(column) for column in columns))


@dataclass(frozen=True, slots=True)
class DriveVector:
    """How a drive stands off another one, the reference: east, north, up (3,), by how many supports."""

    reference: int
    vector_m: Floats
    sigma_m: Floats
    supports: int


@dataclass(frozen=True, slots=True)
class Agreement:
    """What the panels of two drives agree on.

    vector_m, sigma_m (3,): the second drive less the first, east, north, up; zero where the errors that both state
    explain it. supports: how many agree. clear: False where rows of equal panels fit another vector as well.
    """

    vector_m: Floats
    sigma_m: Floats
    supports: int
    clear: bool = True

    @property
    def is_zero(self) -> bool:
        """Whether the stated errors explain all."""
        return not self.vector_m.any()


def measure_differences(
    sightings: Sightings, counted: Flags, settings: MergeSettings
) -> Differences:
    """Pairs of rows with one face that look the same way, up to `reach_m` apart; counted (n,) of the first."""
    pairs = facing_pairs(sightings, sightings.position, settings.reach_m, settings)
    pairs = pairs[counted[pairs[:, 0]]]
    pairs = pairs[face_log_ratio(sightings, pairs[:, 0], pairs[:, 1], settings) > 0]
    i, j = pairs.T
    own = sightings.covariance[:, [0, 1, 2], [0, 1, 2]]
    stated = np.square(sightings.common_sigma_m)[:, [0, 0, 1]]
    return Differences(
        sightings.drive[pairs],
        sightings.row[pairs],
        sightings.assembly[i],
        sightings.position[j] - sightings.position[i],
        own[i] + own[j],
        stated[i] + stated[j],
    )


def agreement_of(pairs: Differences, settings: MergeSettings) -> Agreement | None:
    """What two drives agree on, from all pairs of these two; None where chance may make it.

    First to within the errors of the panels alone, as common errors hardly change along a short drive; else to within
    all stated errors.
    """
    total = pairs.own + pairs.stated
    found = (_agreement(pairs, spread, total, settings) for spread in (pairs.own, total))
    return next((one for one in found if one is not None), None)


def _agreement(
    pairs: Differences, spread: Floats, total: Floats, settings: MergeSettings
) -> Agreement | None:
    """What most supports agree on to within variances (m, 3).

    Supports are counted, as panels on one support move together. Chance puts differences anywhere along `reach_m`. As
    chance count the supports that agree without any vector, too, so that a few panels that were moved are no vector.
    Supports that a rival vector pairs with other panels say nothing.
    """
    gate, nearest2 = float(chi2.ppf(settings.probability, 3)), settings.near_sigmas**2
    count = len(pairs.apart_m)
    tried = np.arange(0, count, max(1, count // _TRIED))
    away = pairs.apart_m - pairs.apart_m[tried, None]
    agree = (np.square(away) / (spread + spread[tried, None])).sum(axis=2) < gate
    support = np.unique(pairs.support, return_inverse=True)[1].ravel()
    shown = np.eye(support.max() + 1)[support]
    best = agree[np.argmax((agree @ shown > 0).sum(axis=1))]
    vector = _mean(pairs.apart_m, spread, best)
    best = _distance2(pairs.apart_m - vector, spread) < gate
    matched = _one_to_one(pairs, _distance2(pairs.apart_m - vector, total), gate)
    if not (best.any() and matched.any()):
        return None
    vector, stated = _mean(pairs.apart_m, total, matched), pairs.stated[matched].mean(axis=0)
    is_zero = bool(_distance2(vector, stated) < nearest2)
    unmoved = 0
    if not is_zero:
        others = np.where(np.isin(support, support[matched])[:, None], 0, shown)
        within = _distance2(pairs.apart_m[tried], total[tried]) < nearest2
        unmoved = int((agree[within] @ others > 0).sum(axis=1).max(initial=0))
    contested = (agree & ~matched) @ _owners(pairs, matched, support) > 0
    supports = len(np.unique(support[best]))
    by_chance = count * float(np.sqrt(gate * spread[best][:, :2].mean())) / settings.reach_m

    def is_sure(agreeing: int) -> bool:
        chance = count * poisson.sf(agreeing - 2, by_chance + unmoved)
        return bool(chance < settings.vector_by_chance)

    clear = is_sure(supports - int(contested.sum(axis=1).max(initial=0)))
    if not clear and (is_zero or not is_sure(supports)):
        return None
    sigma = np.sqrt(stated + 1 / (1 / pairs.own[best]).sum(axis=0))
    return Agreement(vector * (not is_zero), sigma, supports, clear)


def reference_vectors(
    found: Mapping[tuple[int, int], Agreement], first_ns: Mapping[int, int]
) -> dict[int, DriveVector]:
    """Vector of each drive that stands off the reference: of connected drives the most that agree, or the earliest.

    Parameters
    ----------
    found
        By two drives, the lower first.
    first_ns
        By drive, when it saw its first panel.
    """
    clear = {pair: one for pair, one in found.items() if one.clear}
    of = {drive: _Alike([drive], 1, first_ns[drive], drive) for pair in clear for drive in pair}
    result: dict[int, DriveVector] = {}
    zero = np.zeros(3)
    for pair in sorted(clear, key=lambda p: (not clear[p].is_zero, -clear[p].supports, p)):
        one, (a, b) = clear[pair], pair
        if of[a] is of[b]:
            continue
        sign = 1.0
        if of[b].rank() > of[a].rank():
            a, b, sign = b, a, -1.0
        kept, joined = of[a], of[b]
        step = sign * one.vector_m
        for side, drive in ((1.0, a), (-1.0, b)):
            step = step + side * (result[drive].vector_m if drive in result else zero)
        for drive in joined.drives:
            of[drive] = kept
            if not one.is_zero:
                before = result.get(drive)
                vector = step if before is None else step + before.vector_m
                result[drive] = DriveVector(kept.reference, vector, one.sigma_m, one.supports)
        kept.drives += joined.drives
        if one.is_zero:
            kept.count += joined.count
            kept.first_ns, kept.reference = min(
                (side.first_ns, side.reference) for side in (kept, joined)
            )
    return result


@dataclass(slots=True)
class _Alike:
    """Drives that are joined, and how many agree without a vector; the earliest of these is the reference."""

    drives: list[int]
    count: int
    first_ns: int
    reference: int

    def rank(self) -> tuple[int, int, int]:
        """Greater for what stays where it is."""
        return self.count, -self.first_ns, -self.reference


def _mean(values: Floats, variance: Floats, rows: Flags) -> Floats:
    """Mean (3,) of some rows of values (m, 3) by the inverse of their variances."""
    weight = 1 / variance[rows]
    return np.asarray((weight * values[rows]).sum(axis=0) / weight.sum(axis=0), np.float64)


def _distance2(apart: Floats, variance: Floats) -> Floats:
    """Squared Mahalanobis distances (...,) of differences (..., 3)."""
    return np.asarray((np.square(apart) / variance).sum(axis=-1), np.float64)


def _one_to_one(pairs: Differences, distance2: Floats, gate: float) -> Flags:
    """Which pairs (m,) are each other's nearest, by squared distances (m,) below the gate."""
    nearest = distance2 < gate
    for side in (0, 1):
        order = np.lexsort((distance2, pairs.row[:, side]))
        first = np.unique(pairs.row[order, side], return_index=True)[1]
        nearest &= np.isin(np.arange(len(distance2)), order[first])
    return nearest


def _owners(pairs: Differences, matched: Flags, support: Ints) -> Floats:
    """Which supports (m, s) lose a matched panel if a pair holds instead."""
    owners = np.zeros((len(matched), support.max() + 1))
    at = np.flatnonzero(matched)
    for side in (0, 1):
        rows = pairs.row[:, side]
        order = at[np.argsort(rows[at])]
        place = np.minimum(np.searchsorted(rows[order], rows), len(order) - 1)
        taken = np.flatnonzero(rows[order[place]] == rows)
        owners[taken, support[order[place[taken]]]] = 1
    return owners
