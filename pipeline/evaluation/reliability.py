"""Whether the confidence of rows holds: how many of those that state .9 are right."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

CONFIDENCES = (0.0, 0.5, 0.9, 0.99, 1.0)
"""Ends of the ranges that rows are counted in; a row at an end belongs to the range above."""


@dataclass(frozen=True, slots=True)
class ConfidenceBin:
    """Rows of a range of confidence: how many, how many of them right, their mean confidence (nan: no rows)."""

    low: float
    high: float
    rows: int
    right: int
    mean: float

    @property
    def name(self) -> str:
        """Both ends."""
        return f"{self.low:g} to {self.high:g}"


def confidence_bin(
    rows: Iterable[Mapping[str, Any]], wrong: Collection[str], ends: tuple[float, float]
) -> ConfidenceBin:
    """The rows of a sign table between two confidences; `wrong`: ids of those that are not right."""
    low, high = ends
    own = [row for row in rows if low <= row["confidence"] < high or row["confidence"] == high == 1]
    mean = float(np.mean([row["confidence"] for row in own])) if own else float("nan")
    return ConfidenceBin(low, high, len(own), sum(row["sign_id"] not in wrong for row in own), mean)


def reliability(
    rows: Sequence[Mapping[str, Any]], wrong: Collection[str]
) -> tuple[ConfidenceBin, ...]:
    """The rows by `CONFIDENCES`; ranges without a row are left out."""
    bins = (confidence_bin(rows, wrong, ends) for ends in pairwise(CONFIDENCES))
    return tuple(one for one in bins if one.rows)


def bins_together(parts: Iterable[Sequence[ConfidenceBin]]) -> tuple[ConfidenceBin, ...]:
    """The ranges of several drives counted as one."""
    own: defaultdict[tuple[float, float], list[ConfidenceBin]] = defaultdict(list)
    for one in (one for part in parts for one in part):
        own[one.low, one.high].append(one)
    return tuple(
        ConfidenceBin(
            *ends,
            rows := sum(one.rows for one in same),
            sum(one.right for one in same),
            sum(one.mean * one.rows for one in same) / rows,
        )
        for ends, same in sorted(own.items())
    )
