"""Reliability of `confidence`: rows of sign tables against the truth, and recall against precision over the setting."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from reached import table

from wayside.pipeline.evaluation import (
    ConfidenceBin,
    RenderedEvaluation,
    confidence_bin,
    evaluate_against_truth,
    together,
)

BINS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
SETTINGS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)

Row = dict[str, Any]
Result = tuple[list[Row], Row]
"""Rows of `signs.parquet` and the truth of the drive."""


def evaluated_at(results: Sequence[Result], confidence: float) -> RenderedEvaluation:
    """All drives together, by their rows of at least that confidence."""
    return together(
        evaluate_against_truth([row for row in rows if row["confidence"] >= confidence], truth)
        for rows, truth in results
    )


def reliability(results: Sequence[Result]) -> Iterator[ConfidenceBin]:
    """Rows by confidence, and how many are true; a row is matched only against those of its bin and above."""
    for low, high in pairwise(BINS):
        false = {sign.sign_id for sign in evaluated_at(results, low).false}
        yield confidence_bin((row for rows, _ in results for row in rows), false, (low, high))


def calibration_error(bins: Sequence[ConfidenceBin]) -> float:
    """Mean difference between confidence and fraction of true rows, by rows (expected calibration error)."""
    rows = sum(one.rows for one in bins)
    return sum(abs(one.mean * one.rows - one.right) for one in bins if one.rows) / max(rows, 1)


def confidence_lines(
    development: Sequence[Result], other: Sequence[Result], shipped: RenderedEvaluation
) -> list[str]:
    """The part of a page: reliability over all drives, and the setting on both kinds of drives.

    `development` and `other` with hardly a landmark refused; `shipped` the development drives as a run reports them.
    """
    bins = list(reliability([*development, *other]))
    between = sum(one.rows for one in bins if one.low >= 0.1 and one.high <= 0.9)
    return [
        "## Confidence",
        "",
        "Measured with a very low threshold of the landmark classifier, so that rows of low confidence are written (a",
        "run rejects landmarks below the threshold of the model; those between it and `locate.confidence` are",
        "`uncertain`).",
        "*true*: on a panel of its own. All drives above, and more of the same kind from other seeds.",
        "",
        *table(("confidence", "rows", "mean", "true", "fraction"), [bin_row(one) for one in bins]),
        "",
        f"Mean difference between confidence and fraction of true rows: {calibration_error(bins):.3f}. {between} rows "
        "lie between .1 and .9: most landmarks are decided earlier by the box classifier and the geometry; "
        "the middle range is poorly",
        "sampled.",
        "",
        "`locate.confidence` is the setting that trades recall for precision: on the drives above, and on drives of",
        "four of the same specifications from other seeds (*other*). As shipped, .5 gives "
        f"{counts(shipped)} false",
        "on the former.",
        "",
        *table(
            (
                "`locate.confidence`",
                *("found", "false", "recall", "precision"),
                *("found, other", "false", "recall", "precision"),
            ),
            [
                [f"{at:g}", *cells(evaluated_at(development, at)), *cells(evaluated_at(other, at))]
                for at in SETTINGS
            ],
        ),
    ]


def counts(evaluation: RenderedEvaluation) -> str:
    """Found of wanted, and false."""
    return f"{evaluation.found_count} of {evaluation.wanted} found and {len(evaluation.false)}"


def cells(evaluation: RenderedEvaluation) -> list[str]:
    """Found, false, recall and precision as cells of a table."""
    found = f"{evaluation.found_count} of {evaluation.wanted}"
    return [
        found,
        str(len(evaluation.false)),
        f"{evaluation.recall:.3f}",
        f"{evaluation.precision:.3f}",
    ]


def bin_row(one: ConfidenceBin) -> list[str]:
    """One bin as cells of a table."""
    name = f"{one.low:g}-{one.high:g}"
    if one.rows == 0:
        return [name, "0", "-", "-", "-"]
    return [name, str(one.rows), f"{one.mean:.2f}", str(one.right), f"{one.right / one.rows:.2f}"]
