"""The page of causes: what is said of missed, false and wrongly named signs."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest

from wayside.pipeline.evaluation import RenderedEvaluation
from wayside.pipeline.evaluation.figures import Duplicate, FalseSign, MissCause, MissedPanel


@pytest.fixture(scope="module")
def causes(load: Callable[[str], ModuleType]) -> ModuleType:
    return load("causes")


MISSED = MissedPanel(7, "stop", "red", "octagon", 0.75, 0.75, 4.0, 30.0)
FALSE = FalseSign("d-0002", 3, (0.0, 0.0, 9.0, 9.0), "red", "octagon", None, "sign stop 8")
EVALUATION = RenderedEvaluation(
    2,
    (),
    (FALSE,),
    (MISSED,),
    duplicates=(Duplicate("d-0002", 8, "d-0001"),),
    causes=(MissCause(7, "rejected", "score", {"score": 2, "none": 1}),),
)


def test_a_missed_sign_has_the_cause_that_evaluate_gives_it(causes: ModuleType) -> None:
    assert causes.missed_lines("town", EVALUATION) == [
        ("town", "7", "stop", "below the threshold of the box classifier (2 score, 1 none)")
    ]


def test_a_duplicate_is_told_from_other_false_rows(causes: ModuleType) -> None:
    assert causes.false_lines("town", EVALUATION) == [
        ("town", "d-0002", "red octagon, frame 3", "duplicate of d-0001, on sign stop 8")
    ]


def test_the_page_counts_every_part_and_leaves_out_empty_tables(causes: ModuleType) -> None:
    text = causes.page([("town", "3", "stop", "refused")], [], [])
    assert "## Missed signs: 1" in text
    assert "| town | 3 | stop | refused |" in text
    assert "## False signs: 0" in text
    assert text.count("| drive |") == 1
