"""What a result finds on a real drive with labels, at any confidence that is asked for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.evaluation.real import evaluate_against_labels
from wayside.pipeline.results.result import read_rows
from wayside.schemas.tables import OBSERVATIONS, SIGNS

PLATES = ("parking plate", "bus stop plate")
"""Kinds of the labels that stand for parking and bus stop plates: small, and hung in touching pairs and fours."""

CONFIDENCES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Confidences whose counts are listed; a run reports signs from 0.5 on."""


@dataclass(frozen=True, slots=True)
class Counts:
    """Signs found of those wanted, without plates and plates alone, rows on no sign, and images."""

    found: int = 0
    wanted: int = 0
    plates: int = 0
    wanted_plates: int = 0
    false: int = 0
    images: int = 0

    def plus(self, other: Counts) -> Counts:
        """Both together."""
        return Counts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


def total(counts: Iterable[Counts]) -> Counts:
    """All together."""
    whole = Counts()
    for one in counts:
        whole = whole.plus(one)
    return whole


def counts_by_confidence(
    out: Path, labels: Mapping[str, Any], confidences: Sequence[float] = CONFIDENCES
) -> tuple[Counts, ...]:
    """Counts of a result against labels, rows of at least each confidence taken as signs; none where none is stated."""
    columns = ("sign_id", "status", "confidence", "best_frame", "best_box", "color", "shape")
    rows = [row for row in read_rows(out, SIGNS, columns) if row["status"] != "back"]
    if any(row["confidence"] is None for row in rows):
        return ()
    seen = read_rows(out, OBSERVATIONS, ("sign_id", "frame", "box"))
    return tuple(
        _counts([row for row in rows if row["confidence"] >= least], seen, labels)
        for least in confidences
    )


def _counts(
    signs: Sequence[dict[str, Any]], seen: Sequence[dict[str, Any]], labels: Mapping[str, Any]
) -> Counts:
    evaluation = evaluate_against_labels(signs, seen, labels)
    plates = [one for one in evaluation.kinds if one.kind in PLATES]
    right, wanted = sum(one.found for one in plates), sum(one.wanted for one in plates)
    return Counts(
        len(evaluation.found) - right,
        evaluation.wanted - wanted,
        right,
        wanted,
        len(evaluation.false),
        len(labels["frames"]),
    )
