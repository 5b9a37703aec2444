"""The tables of real drives: by source, with intervals, with the plates apart and the misses by cause."""

from dataclasses import replace
from pathlib import Path

import pytest

import wayside
from wayside.pipeline.evaluation.figures import Duplicate, MissCause, RealEvaluation

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"


@pytest.fixture(scope="module")
def tables(load):
    return load("real_tables")


FALSE = {"sign_id": "d-0002", "best_frame": 3, "cause": "unlabelled"}
CAUSES = (
    MissCause("R2", "rejected", "score", {"score": 2}),
    MissCause("R3", "refused", "residual", {"residual": 3}),
)
AGAIN = (Duplicate("d-0003", "R1", "d-0001"),)
KNOWN = {"duplicates": AGAIN, "causes": CAUSES, "images": 50, "learned_by": ()}
ROAD = RealEvaluation(3, ("R1",), 2, (FALSE,), ("R2", "R3"), **KNOWN)
PLATES = (("parking plate", True), ("parking plate", False), ("bus stop plate", True))
CITY = replace(
    RealEvaluation(4, ("P1", "B1", "G1"), 3, (), ("P2",), by_kind=(*PLATES, ("guide", True))),
    causes=(MissCause("P2", "rejected", "score", {"score": 1}),),
    images=100,
    learned_by=(),
)


def test_a_line_has_every_share_with_its_interval(tables):
    head, _, line = tables.share_table([tables.RealDrive("road", ROAD, 1)])
    assert head.count("95 %") == 3
    # Wilson of 1 in 3 and of 2 in 3; Garwood of one: 0.0253 and 5.572, in 50 images
    assert line == (
        "| road | 50 | 1 of 3 | 0.333 (0.061 to 0.792) | 2 of 3 | 1 | 0.667 (0.208 to 0.939) | 1 "
        "| 2.0 (0.1 to 11.1) | 1 |"
    )


def test_drives_learned_from_stand_apart_and_are_summed_apart(tables):
    drives = {"seen": replace(ROAD, learned_by=("network",)), "road": ROAD, "city": CITY}
    lines = tables.real_page([tables.RealDrive(*drive) for drive in drives.items()])
    titles = [line for line in lines if line.startswith("### ")]
    assert titles[:2] == [
        "### Never seen by a model of the run",
        "### Learned from by a model of the run",
    ]
    first, second = (lines.index(title) for title in titles[:2])
    never, learned = "\n".join(lines[first:second]), "\n".join(lines[second:])
    assert "| **together** | 150 | 4 of 7 |" in never
    assert "| seen (network) | 50 | 1 of 3 |" in learned
    assert "seen" not in never.replace(titles[0], "")
    assert "**together**" not in learned
    unknown = tables.real_page([tables.RealDrive("old", replace(ROAD, learned_by=None, causes=()))])
    titles = [line for line in unknown if line.startswith("#")]
    assert titles == ["### Not known whether learned from"]


def test_plates_have_a_row_of_their_own_that_adds_up_with_the_rest(tables):
    lines = tables.kind_table([tables.RealDrive("city", CITY), tables.RealDrive("road", ROAD)])
    assert [line.split(" | ")[:2] for line in lines[3:]] == [
        ["| parking and bus stop plates", "2 of 3"],
        ["| all other signs", "2 of 4"],
    ]
    assert tables.kind_table([tables.RealDrive("road", ROAD)]) == []


def test_every_miss_has_its_cause_and_each_step_its_count(tables):
    lines = tables.real_page([tables.RealDrive("road", ROAD), tables.RealDrive("city", CITY)])
    assert (
        "| drive | missed | below the threshold of the box classifier | followed and refused |"
        in lines
    )
    assert "| road | 2 | 1 | 1 |" in lines
    assert "| city | 1 | 1 | 0 |" in lines
    assert "| road | R2 | below the threshold of the box classifier (2 score) |" in lines


def test_counts_at_each_confidence_are_added_over_drives(tables):
    steps = range(len(tables.CONFIDENCES))
    road = tuple(tables.Counts(3 - (k > 1), 4, 0, 0, 2 - (k > 1), 50) for k in steps)
    city = tuple(tables.Counts(1, 2, 3, 4, 0, 150) for _ in steps)
    lines = tables.confidence_table(
        [tables.RealDrive("road", ROAD, 0, road), tables.RealDrive("city", CITY, 0, city)]
    )
    assert len(lines) == 3 + len(tables.CONFIDENCES)
    assert lines[3] == "| 0.3 | 3 of 4 | 4 of 6 | 0.667 (0.300 to 0.903) | 2 | 1.0 (0.1 to 3.6) |"
    assert lines[5].startswith("| 0.5 | 3 of 4 | 3 of 6 |")
    assert tables.confidence_table([tables.RealDrive("road", ROAD)]) == []


def test_a_higher_confidence_keeps_fewer_rows_of_a_result(tables, tmp_path):
    run = wayside.run(DEMO, settings={"read.until_s": 0.7}, out=tmp_path)
    rows = [row for row in run.signs.to_pylist() if row["status"] != "back"]
    signs = [
        {"id": row["sign_id"], "wanted": True, "kind": kind, "boxes": [view]}
        for row, kind in zip(rows, ["guide", "parking plate", *["guide"] * len(rows)], strict=False)
        if (view := {"i": row["best_frame"], "box": row["best_box"]})
    ]
    labels = {"stride": 1, "frames": [{}] * 7, "signs": signs, "distractors": []}
    least = (0.0, sorted(row["confidence"] for row in rows)[1], 1.0)
    every, one_less, none = tables.counts_by_confidence(tmp_path, labels, least)
    assert every == tables.Counts(len(rows) - 1, len(rows) - 1, 1, 1, 0, 7)
    assert one_less.found + one_less.plates == len(rows) - 1
    assert none == tables.Counts(0, len(rows) - 1, 0, 1, 0, 7)
    nothing = labels | {"signs": signs[:1]}
    assert tables.counts_by_confidence(tmp_path, nothing, (0.0,))[0].false == len(rows) - 1
