"""Causes of misses: the last step that a candidate on a sign passed, and what each view says."""

import pyarrow as pa
import pytest

from wayside.pipeline.evaluation.figures import MissCause
from wayside.pipeline.evaluation.misses import (
    STEPS,
    Candidates,
    Face,
    cause_words,
    count_steps,
    miss_cause,
)
from wayside.schemas.detections import VERDICTS
from wayside.schemas.tables import OBSERVATIONS

BOX = [10.0, 10.0, 30.0, 30.0]
BESIDE = [60.0, 10.0, 80.0, 30.0]
FRAMES = dict.fromkeys(range(4), "used") | {4: "thinned"}


def cause(seen, views=(0, 1, 2), rows=None, distances=None):
    names = Candidates.COLUMNS
    schema = pa.schema([OBSERVATIONS.schema.field(name) for name in names])
    listed = [dict(zip(names, row, strict=True)) for row in sorted(seen, key=lambda row: row[0])]
    table = pa.Table.from_pylist(listed, schema=schema)
    face = Face("R1", dict.fromkeys(views, BOX), distances or {})
    return miss_cause(face, Candidates(table), FRAMES, rows or {})


def test_where_nothing_lies_on_a_sign_no_candidate_is_the_cause():
    found = cause([(0, BESIDE, "sign", 1, "a"), (9, BOX, "sign", 1, "a")])
    assert (found.step, found.reason, found.views) == ("no_candidate", "none", {"none": 3})
    assert cause([], views=(3, 4)).step == "no_candidate"


@pytest.mark.parametrize(
    ("verdict", "track", "step"),
    [
        ("size", None, "gate"),
        ("score", None, "rejected"),
        ("overlap", None, "suppressed"),
        ("moving", None, "not_followed"),
        ("moving", 3, "refused"),
    ],
)
def test_one_view_that_came_further_decides_against_two_that_did_not(verdict, track, step):
    found = cause([(1, BOX, verdict, track, None)])
    assert (found.step, found.reason) == (step, verdict)
    assert found.views == {"none": 2, verdict: 1}


def test_the_furthest_candidate_of_a_view_speaks_and_the_most_frequent_verdict_there():
    nearer = [11.0, 10.0, 31.0, 30.0]
    found = cause([(0, BOX, "score", None, None), (0, nearer, "residual", 2, None)], views=(0,))
    assert (found.step, found.views) == ("refused", {"residual": 1})
    often = [(frame, BOX, "place_score", 2, None) for frame in (1, 2)]
    found = cause([(0, BOX, "location", 1, None), *often])
    assert (found.step, found.reason) == ("refused", "place_score")


def test_a_sign_in_images_that_were_not_used_or_not_read_is_lost_there():
    found = cause([(4, BOX, "sign", 1, "a")], views=(4, 77))
    assert (found.step, found.views) == ("unused", {"thinned": 1, "not_read": 1})
    assert cause([], views=()).step == "unused"


@pytest.mark.parametrize(
    ("status", "distances", "reason", "words"),
    [
        ("uncertain", {}, "uncertain", "d-0007 is on it with status uncertain"),
        ("back", {}, "back", "d-0007 is on it with status back"),
        ("sign", {"d-0007": 10.66}, "misplaced", "d-0007 is on it but stands 10.7 m"),
        ("sign", {}, "other_sign", "d-0007 is on it but is that of another sign"),
    ],
)
def test_a_row_on_the_sign_says_why_it_is_not_this_sign(status, distances, reason, words):
    found = cause([(1, BOX, "sign", 7, "d-0007")], rows={"d-0007": status}, distances=distances)
    assert (found.step, found.reason, found.row) == ("reported", reason, "d-0007")
    assert cause_words(found).startswith(words)
    assert cause_words(found).endswith("(2 none, 1 sign)")


def test_every_verdict_has_a_step_and_words():
    for verdict in VERDICTS:
        found = cause([(0, BOX, verdict, None, None)])
        assert found.step in STEPS
        assert "1 " + verdict in cause_words(found)


def test_causes_are_counted_in_the_order_of_the_work():
    causes = [MissCause(1, step, "", {}) for step in ("refused", "rejected", "refused")]
    assert list(count_steps(causes).items()) == [("rejected", 1), ("refused", 2)]
