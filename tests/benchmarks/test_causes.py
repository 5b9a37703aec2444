"""The page of causes: what is said of a missed sign's views."""

import numpy as np
import pytest

BOX = np.array([10.0, 10.0, 30.0, 30.0])


@pytest.fixture(scope="module")
def causes(load):
    return load("causes")


@pytest.mark.parametrize(
    ("boxes", "verdicts", "said"),
    [
        ([], [], "none"),
        ([[200, 10, 220, 30]], ["sign"], "none"),
        ([[10, 10, 30, 18], [11, 10, 30, 30]], ["sign", "overlap"], "overlap"),
    ],
)
def test_a_view_is_spoken_for_by_the_candidate_that_overlaps_it_most(causes, boxes, verdicts, said):
    table = np.array(boxes, np.float64).reshape(-1, 4)
    assert causes.verdict_on(BOX, table, np.array(verdicts, str)) == said


def test_the_page_counts_every_part_and_leaves_out_empty_tables(causes):
    text = causes.page([("town", "3", "stop", "refused")], [], [])
    assert "## Missed signs: 1" in text
    assert "| town | 3 | stop | refused |" in text
    assert "## False signs: 0" in text
    assert text.count("| drive |") == 1
