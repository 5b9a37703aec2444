"""Evaluation of a result against the truth, beside the reference scorer where it is at hand."""

import json
import math
import runpy
import sys
from operator import itemgetter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wayside.pipeline.evaluation import (
    KindCount,
    RealEvaluation,
    RenderedEvaluation,
    evaluate,
    format_evaluation,
    together,
    write_evaluation,
)
from wayside.pipeline.evaluation.figures import Backs, Duplicate
from wayside.pipeline.labels.box_matching import same_thing
from wayside.pipeline.statistics import fraction, spread
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.tables import FRAMES as FRAME_TABLE
from wayside.schemas.tables import OBSERVATIONS, SIGNS

REFERENCE = Path(__file__).parents[3] / "shared" / "tools" / "score.py"


# --- truth and results made for the test ---------------------------------------------------------


def frame(index, x, quaternion=(-0.5, 0.5, -0.5, 0.5)):
    return {"index": index, "position": [x, 0.0, 2.0], "quaternion": list(quaternion)}


def panel(number, centre, **change):
    views = [
        {"frame": i, "box": [100, 100, 120, 120 + i], "side": "front", "visible_fraction": 1.0}
        for i in range(3)
    ]
    return {
        "id": number,
        "kind": "stop",
        "color": "red",
        "shape": "octagon",
        "centre": list(centre),
        "width_m": 0.75,
        "height_m": 0.75,
        "bottom_m": 1.5,
        "lateral_m": 4.0,
        "station_m": 30.0,
        "faces_travel": True,
        "frames": views,
    } | change


def sign(number, place, **change):
    right, down, ahead = place
    return {
        "sign_id": f"drive-{number:04}",
        "status": "sign",
        "confidence": None,
        "color": "red",
        "shape": "octagon",
        "best_frame": 0,
        "best_box": [100.0, 100.0, 120.0, 120.0],
        "right_m": right,
        "down_m": down,
        "ahead_m": ahead,
        "panel_width_m": 0.75,
        "panel_height_m": 0.75,
        "bottom_m": 1.5,
        "sigma_lateral_m": 0.1,
        "sigma_up_m": 0.1,
        "sigma_along_m": 0.1,
    } | change


def write_table(folder, table, rows):
    empty = {"string": "", "bool": False}
    filled = []
    for row in rows:
        values = {}
        for column in table.columns:
            blank = column.values[0] if column.values else empty.get(str(column.type), 0)
            if pa.types.is_fixed_size_list(column.type):
                blank = [0.0] * column.type.list_size
            values[column.name] = row.get(column.name, None if column.nullable else blank)
        filled.append(values)
    folder.mkdir(exist_ok=True)
    pq.write_table(pa.Table.from_pylist(filled, schema=table.schema), folder / table.file)


IMAGES = 50
"""Images of a result made for the test, all used."""


def write_result(folder, signs, observations=()):
    write_table(folder, SIGNS, signs)
    rows = [{"verdict": "sign" if row.get("sign_id") else "score"} | row for row in observations]
    write_table(folder, OBSERVATIONS, sorted(rows, key=itemgetter("frame")))
    write_table(folder, FRAME_TABLE, [{"frame": i, "status": "used"} for i in range(IMAGES)])


def evaluated(tmp_path, signs, truth=None):
    """By default against one panel 30 m ahead."""
    write_result(tmp_path / "out", signs)
    truth = {"frames": FRAMES, "signs": [AT_30_M]} if truth is None else truth
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    evaluation = evaluate(tmp_path / "out", tmp_path / "truth.json")
    assert isinstance(evaluation, RenderedEvaluation)
    return evaluation


def evaluated_on_labels(tmp_path, signs, observations, labels):
    write_result(tmp_path / "out", signs, observations)
    (tmp_path / "labels.json").write_text(json.dumps(labels))
    evaluation = evaluate(tmp_path / "out", tmp_path / "labels.json")
    assert isinstance(evaluation, RealEvaluation)
    return evaluation


# --- rendered drives -----------------------------------------------------------------------------

FRAMES = [frame(i, 8.0 * i) for i in range(4)]
AT_30_M = panel(1, (30.0, -4.0, 3.0))
ON_IT = (4.0, -1.0, 30.0)


def test_a_panel_at_its_true_place_is_found_without_error(tmp_path):
    evaluation = evaluated(tmp_path, [sign(1, ON_IT)])
    assert (evaluation.recall, evaluation.precision) == (1.0, 1.0)
    assert evaluation.found == (("drive-0001", 1),)
    assert evaluation.error_m["total"].median == pytest.approx(0, abs=1e-4)
    assert evaluation.color_right == evaluation.shape_right == 1.0


def test_errors_are_told_apart_by_axis_of_the_camera(tmp_path):
    reported = sign(1, (4.3, -1.2, 31.0), sigma_lateral_m=0.2, sigma_up_m=0.4, sigma_along_m=0.3)
    evaluation = evaluated(tmp_path, [reported])
    medians = {name: value.median for name, value in evaluation.error_m.items()}
    assert medians == {
        "lateral": 0.3,
        "up": 0.2,
        "along": 1.0,
        "total": pytest.approx(1.063, abs=1e-3),
    }
    within = {name: (value.one, value.two) for name, value in evaluation.sigma_share.items()}
    assert within == {"lateral": (0.0, 1.0), "up": (1.0, 1.0), "along": (0.0, 0.0)}


@pytest.mark.parametrize(
    ("right", "ahead", "found"),
    [(5.49, 30.0, True), (5.6, 30.0, False), (4.0, 33.0, True), (4.0, 33.2, False)],
)
def test_a_match_reaches_as_far_as_said_and_no_farther(tmp_path, right, ahead, found):
    evaluation = evaluated(tmp_path, [sign(1, (right, -1.0, ahead))])
    assert (evaluation.found_count == 1) is found
    assert len(evaluation.missed) == len(evaluation.false) == (0 if found else 1)


def test_one_panel_is_found_once_and_by_the_nearest(tmp_path):
    signs = [sign(1, (4.5, -1.0, 30.0)), sign(2, ON_IT)]
    evaluation = evaluated(tmp_path, signs)
    assert evaluation.found == (("drive-0002", 1),)
    assert [false.sign_id for false in evaluation.false] == ["drive-0001"]


def test_a_second_row_on_a_found_face_is_a_duplicate_wherever_it_stands(tmp_path):
    far = sign(1, (4.0, -1.0, 41.0), best_box=[101.0, 100.0, 121.0, 121.0])
    elsewhere = sign(3, (9.0, 0.0, 50.0), best_box=[500.0, 500.0, 520.0, 520.0])
    evaluation = evaluated(tmp_path, [far, sign(2, ON_IT), elsewhere])
    assert evaluation.duplicates == (Duplicate("drive-0001", 1, "drive-0002"),)
    assert [row.sign_id for row in evaluation.false] == ["drive-0001", "drive-0003"]
    assert [row.sign_id for row in evaluation.others] == ["drive-0003"]
    assert evaluation.precision == pytest.approx(1 / 3)
    text = format_evaluation(evaluation)
    assert "false      2       duplicates 1, others 1; 4.00 per 100 images" in text
    assert "drive-0001  of drive-0002, on sign 1" in text


HIDDEN = AT_30_M["frames"][0] | {"frame": 3, "visible_fraction": 0.2}


@pytest.mark.parametrize(
    ("row", "found"),
    [
        (sign(1, (4.0, -1.0, 41.0)), False),
        (sign(1, (1.0, 0.0, 3.0), best_frame=3), True),
        (sign(1, (4.0, 0.0, 30.0), best_box=[100.0, 122.0, 120.0, 140.0]), True),
    ],
    ids=["on a face that no row found", "on what hides a found face", "beside a found face"],
)
def test_a_row_that_is_false_is_not_always_a_duplicate(tmp_path, row, found):
    panel = AT_30_M | {"frames": [*AT_30_M["frames"], HIDDEN]}
    signs = [row, sign(2, ON_IT)] if found else [row]
    evaluation = evaluated(tmp_path, signs, {"frames": FRAMES, "signs": [panel]})
    assert (evaluation.duplicates, len(evaluation.false)) == ((), 1)


@pytest.mark.parametrize(
    "change",
    [
        {"faces_travel": False},
        {"frames": AT_30_M["frames"][:2]},
        {"frames": [view | {"box": [0, 0, 9, 9.9]} for view in AT_30_M["frames"]]},
        {"frames": [view | {"visible_fraction": 0.4} for view in AT_30_M["frames"]]},
    ],
    ids=["turned away", "too few images", "too small", "hidden"],
)
def test_a_panel_that_need_not_be_found_counts_as_neither(tmp_path, change):
    truth = {"frames": FRAMES, "signs": [AT_30_M | change]}
    evaluation = evaluated(tmp_path, [sign(1, ON_IT)], truth)
    assert (evaluation.wanted, evaluation.found_count, len(evaluation.false)) == (0, 0, 0)
    assert (evaluation.recall, evaluation.precision) == (1.0, 1.0)


def test_a_back_is_no_panel_to_match(tmp_path):
    views = [view | {"side": "back", "visible_fraction": None} for view in AT_30_M["frames"]]
    truth = {"frames": FRAMES, "signs": [AT_30_M | {"frames": views}]}
    evaluation = evaluated(tmp_path, [sign(1, ON_IT)], truth)
    assert [false.cause for false in evaluation.false] == ["sign stop 1"]


def test_backs_and_uncertain_rows_are_not_evaluated(tmp_path):
    signs = [sign(1, (0, 0, 9), status="back"), sign(2, (0, 0, 9), status="uncertain")]
    evaluation = evaluated(tmp_path, signs)
    assert not evaluation.false
    assert evaluation.recall == 0.0


def test_backs_are_counted_apart_right_where_a_panel_is_seen_from_behind(tmp_path):
    views = [view | {"side": "back", "visible_fraction": None} for view in AT_30_M["frames"]]
    behind = AT_30_M | {"id": 4, "faces_travel": False, "frames": views}
    front = AT_30_M | {"id": 5, "centre": [40.0, 0.0, 2.0]}
    on_back, on_nothing = sign(1, ON_IT, status="back"), sign(2, (0, 0, 9), status="back")
    evaluation = evaluated(
        tmp_path, [on_back, on_nothing], {"frames": FRAMES, "signs": [behind, front]}
    )
    assert evaluation.backs == Backs(reported=2, right=1, in_view=1)
    assert not evaluation.false
    both = together([evaluation, evaluation])
    assert both.backs == Backs(4, 2, 2)
    assert "backs      1 of 2 right, 1 in view" in format_evaluation(evaluation)


def test_a_false_sign_names_the_distractor_it_lies_on(tmp_path):
    billboard = {
        "id": "b-7",
        "kind": "billboard",
        "frames": [{"frame": 0, "box": [90, 90, 150, 150]}],
    }
    truth = {"frames": FRAMES, "signs": [], "distractors": [billboard]}
    elsewhere = sign(2, (9, 0, 50), best_box=[500.0, 500.0, 520.0, 520.0])
    evaluation = evaluated(tmp_path, [sign(1, (9, 0, 50)), elsewhere], truth)
    assert [false.cause for false in evaluation.false] == ["distractor billboard b-7", "unknown"]
    assert evaluation.false[0].position == (9, 0, 50)


def test_a_sign_whose_best_frame_is_not_in_the_truth_is_false(tmp_path):
    evaluation = evaluated(tmp_path, [sign(1, ON_IT, best_frame=77)])
    assert len(evaluation.false) == 1


def test_rows_are_counted_by_their_confidence_uncertain_ones_among_them(tmp_path):
    signs = [
        sign(1, ON_IT, confidence=0.95),
        sign(2, (9, 0, 50), confidence=0.99),
        sign(3, (9, 9, 50), confidence=1.0),
        sign(4, (9, 9, 40), confidence=0.3, status="uncertain"),
        sign(5, (9, 9, 40), confidence=0.9, status="back"),
        sign(6, (9, 9, 30), confidence=None),
    ]
    evaluation = evaluated(tmp_path, signs)
    counted = {one.name: (one.rows, one.right) for one in evaluation.reliability}
    assert counted == {"0 to 0.5": (1, 0), "0.9 to 0.99": (1, 1), "0.99 to 1": (2, 0)}
    assert evaluation.reliability[-1].mean == pytest.approx(0.995)
    twice = together([evaluation, evaluation]).reliability
    assert [(one.rows, one.mean) for one in twice] == [
        (2 * one.rows, pytest.approx(one.mean)) for one in evaluation.reliability
    ]
    text = format_evaluation(evaluation)
    assert "0.9 to 0.99              1   0.950           1   1.000   0.025 to 1.000" in text
    assert evaluation.to_json()["reliability"][0]["rows"] == 1


def test_unknown_sizes_and_sigmas_are_left_out(tmp_path):
    reported = sign(1, ON_IT, panel_width_m=None, bottom_m=None, sigma_up_m=None, sigma_along_m=0.0)
    evaluation = evaluated(tmp_path, [reported])
    assert (evaluation.width_error.n, evaluation.bottom_error_m.n) == (0, 0)
    assert (evaluation.sigma_share["up"].n, evaluation.sigma_share["along"].n) == (0, 0)
    assert evaluation.height_error.median == 0.0


# --- real drives ---------------------------------------------------------------------------------


def labels(*signs, distractors=()):
    return {
        "log": "d.mcap",
        "stride": 4,
        "frames": [],
        "signs": list(signs),
        "distractors": list(distractors),
    }


LABEL = {"id": "R1", "wanted": True, "boxes": [{"i": 5, "box": [100, 100, 120, 120]}]}


def test_a_label_is_found_by_an_observation_of_a_reported_sign(tmp_path):
    seen = {"sign_id": "drive-0001", "frame": 5, "box": [101.0, 101.0, 121.0, 121.0]}
    evaluation = evaluated_on_labels(tmp_path, [sign(1, ON_IT)], [seen], labels(LABEL))
    assert (evaluation.found, evaluation.missed, evaluation.false) == (("R1",), (), ())


def test_an_uncertain_row_on_a_label_is_counted_by_its_confidence(tmp_path):
    seen = {"sign_id": "drive-0001", "frame": 5, "box": [101.0, 101.0, 121.0, 121.0]}
    rows = [sign(1, ON_IT, confidence=0.4, status="uncertain"), sign(2, ON_IT, confidence=0.45)]
    evaluation = evaluated_on_labels(tmp_path, rows, [seen], labels(LABEL))
    (only,) = evaluation.reliability
    assert (only.rows, only.right, only.mean) == (2, 1, pytest.approx(0.425))
    assert evaluation.found == ()
    assert "on a label" in format_evaluation(evaluation)


def test_observations_of_no_sign_find_nothing(tmp_path):
    seen = {"sign_id": None, "frame": 5, "box": [100.0, 100.0, 120.0, 120.0]}
    evaluation = evaluated_on_labels(tmp_path, [], [seen], labels(LABEL))
    assert (evaluation.recall, evaluation.missed, evaluation.precision) == (0.0, ("R1",), 1.0)


def test_a_label_that_need_not_be_found_saves_its_sign_from_being_false(tmp_path):
    on_it = sign(1, ON_IT, best_frame=5)
    evaluation = evaluated_on_labels(tmp_path, [on_it], [], labels(LABEL | {"wanted": False}))
    assert (evaluation.wanted, evaluation.touching, evaluation.false) == (0, 1, ())


def test_a_second_row_on_a_label_is_a_duplicate_and_not_false(tmp_path):
    on_it = sign(1, ON_IT, best_frame=5)
    rough = sign(2, ON_IT, best_frame=5, best_box=[98.0, 97.0, 123.0, 125.0])
    evaluation = evaluated_on_labels(tmp_path, [rough, on_it], [], labels(LABEL))
    assert evaluation.duplicates == (Duplicate("drive-0002", "R1", "drive-0001"),)
    assert (evaluation.touching, evaluation.false, evaluation.precision) == (2, (), 1.0)


def test_two_rows_on_two_touching_labels_are_none_of_them_a_duplicate(tmp_path):
    lower = {"id": "R2", "wanted": True, "boxes": [{"i": 5, "box": [100, 112, 120, 132]}]}
    both = [
        sign(1, ON_IT, best_frame=5, best_box=[100.0, 101.0, 120.0, 121.0]),
        sign(2, ON_IT, best_frame=5, best_box=[100.0, 108.0, 120.0, 128.0]),
    ]
    evaluation = evaluated_on_labels(tmp_path, both, [], labels(LABEL, lower))
    assert (evaluation.found, evaluation.duplicates) == (("R1", "R2"), ())


def test_recall_is_told_by_kind_where_labels_name_kinds(tmp_path):
    marks = [
        LABEL | {"kind": "parking plate"},
        LABEL | {"id": "R2", "kind": "parking plate", "boxes": []},
        LABEL | {"id": "R3", "boxes": []},
        LABEL | {"id": "R4", "kind": "guide", "wanted": False},
    ]
    evaluation = evaluated_on_labels(tmp_path, [sign(1, ON_IT, best_frame=5)], [], labels(*marks))
    assert evaluation.kinds == (KindCount("parking plate", 2, 1), KindCount("other", 1, 0))
    both = together([evaluation, evaluation])
    assert both.kinds == (KindCount("parking plate", 4, 2), KindCount("other", 2, 0))
    assert (both.wanted, both.found_count, both.images) == (6, 2, 2 * IMAGES)
    assert "parking plate                                     2      1   0.500" in (
        format_evaluation(evaluation)
    )


def test_every_share_of_a_real_drive_stands_with_its_interval(tmp_path):
    off_it = sign(2, ON_IT, best_frame=9)
    evaluation = evaluated_on_labels(
        tmp_path, [sign(1, ON_IT, best_frame=5), off_it], [], labels(LABEL)
    )
    lines = format_evaluation(evaluation).splitlines()
    # exact for all of one: 0.025; Wilson of one in two; Garwood of one: 0.0253 and 5.572, in 50 images
    assert lines[0] == "recall     1.000   1 of 1 found, 95 %: 0.025 to 1.000"
    assert lines[1].startswith("precision  0.500   1 of 2 rows on a label, 95 %: 0.095 to 0.905")
    assert lines[2] == "false      1       on no label; 2.00 per 100 images, 95 %: 0.05 to 11.14"


def test_a_result_says_whether_its_models_were_learned_from_the_log(tmp_path):
    evaluation = evaluated_on_labels(tmp_path, [], [], labels(LABEL))
    assert evaluation.learned_by is None
    assert "learned" not in format_evaluation(evaluation)
    for models, words in (([], "no model"), (["box", "network"], "box, network")):
        (tmp_path / "out" / "run.json").write_text(json.dumps({"learned_from_log": models}))
        evaluation = evaluate(tmp_path / "out", tmp_path / "labels.json")
        assert evaluation.learned_by == tuple(models)
        assert f"learned    {words} of this run from this log" in format_evaluation(evaluation)


def test_a_false_sign_on_a_boxed_distractor_says_which(tmp_path):
    flag = {"what": "advertising flag", "source_frame": 32, "box": [100, 100, 120, 120]}
    on_it, off_it = sign(1, ON_IT, best_frame=8), sign(2, ON_IT, best_frame=9)
    evaluation = evaluated_on_labels(tmp_path, [on_it, off_it], [], labels(distractors=(flag,)))
    assert [false.cause for false in evaluation.false] == ["advertising flag", "unlabelled"]


def test_a_small_box_inside_a_large_one_is_the_same_thing_up_to_a_factor_of_five():
    assert same_thing([40, 40, 60, 60], [30, 30, 70, 70])
    assert not same_thing([40, 40, 60, 60], [0, 0, 100, 100])
    assert not same_thing([0, 0, 10, 10], [20, 20, 30, 30])


# --- what cannot be evaluated -----------------------------------------------------------------------


OTHER = pa.table({"sign_id": ["a"], "status": ["sign"]})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "wayside run"),
        ("sign_id\n", r"signs\.parquet cannot be read"),
        (OTHER, "lacks the column best_frame"),
    ],
    ids=["no table", "no parquet", "a table of another program"],
)
def test_a_folder_without_the_table_of_signs_is_refused(tmp_path, content, words):
    if isinstance(content, str):
        (tmp_path / "signs.parquet").write_text(content)
    elif content is not None:
        pq.write_table(content, tmp_path / "signs.parquet")
    (tmp_path / "truth.json").write_text(json.dumps({"frames": [], "signs": []}))
    with pytest.raises(InputError, match=words):
        evaluate(tmp_path, tmp_path / "truth.json")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "cannot be read"),
        ("{", "not JSON"),
        ("[]", "neither the truth"),
        ('{"signs": []}', "neither the truth"),
        ('{"signs": [{"id": 1}], "frames": []}', "not as expected"),
    ],
)
def test_a_wrong_truth_file_is_refused(tmp_path, text, words):
    write_result(tmp_path, [])
    if text is not None:
        (tmp_path / "truth.json").write_text(text)
    with pytest.raises(InputError, match=words):
        evaluate(tmp_path, tmp_path / "truth.json")


def test_a_result_without_images_is_evaluated(tmp_path):
    write_result(tmp_path, [])
    write_table(tmp_path, FRAME_TABLE, [])
    (tmp_path / "truth.json").write_text(json.dumps({"frames": [], "signs": []}))
    evaluation = evaluate(tmp_path, tmp_path / "truth.json")
    assert (evaluation.images, evaluation.false_per_100_images) == (0, None)


def test_figures_that_cannot_be_written_say_so(tmp_path):
    evaluation = RealEvaluation(0, (), 0, (), ())
    with pytest.raises(OutputError, match="the file cannot be written: No such file"):
        write_evaluation(evaluation, tmp_path / "missing" / "figures.json")


# --- words and small statistics ------------------------------------------------------------------


def test_the_table_for_a_person_holds_every_part(tmp_path):
    truth = {"frames": FRAMES, "signs": [AT_30_M, panel(2, (60.0, 5.0, 3.0), kind="yield")]}
    signs = [sign(1, ON_IT, color="orange"), sign(2, (0, 0, 9))]
    text = format_evaluation(evaluated(tmp_path, signs, truth))
    for part in (
        "recall     0.500   1 of 2 found",
        "precision  0.500   1 of 2 rows",
        "false      1       duplicates 0, others 1",
        "along, m",
        "red -> orange (1)",
        "drive-0002  frame 0  red octagon",
        "yield, red octagon",
    ):
        assert part in text
    assert all(len(line) <= 120 for line in text.splitlines())


def test_the_table_of_a_real_drive_lists_what_was_missed():
    text = format_evaluation(RealEvaluation(2, ("R1",), 1, (), ("R2",)))
    assert text.splitlines()[0] == "recall     0.500   1 of 2 found, 95 %: 0.095 to 0.905"
    assert text.splitlines()[-1] == "  R2"


@given(st.lists(st.floats(0, 100), max_size=30))
def test_a_spread_lies_within_its_values(values):
    result = spread(values)
    assert result.n == len(values)
    if result.median is not None and result.p95 is not None:
        assert min(values) - 1e-4 <= result.median <= result.p95 <= max(values) + 1e-4


def test_shares_of_nothing_are_unknown():
    assert fraction([]) is None
    assert spread([]).median is None


BOXES = st.tuples(st.floats(0, 90), st.floats(0, 90), st.floats(0.1, 50), st.floats(0.1, 50)).map(
    lambda b: [b[0], b[1], b[0] + b[2], b[1] + b[3]]
)


@given(BOXES)
def test_a_box_is_the_same_as_itself(a):
    assert same_thing(a, a)


# --- beside the reference scorer -----------------------------------------------------------------

needs_reference = pytest.mark.skipif(
    not REFERENCE.is_file(), reason="the reference scorer is not beside this checkout"
)


@needs_reference
@pytest.mark.parametrize("seed", range(3))
def test_figures_of_rendered_drives_are_those_of_the_reference(tmp_path, seed):
    signs, truth = random_rendered(np.random.default_rng(seed))
    apart = panel(99, (900.0, -4.0, 3.0))
    truth["signs"].append(apart)
    pose = truth["frames"][0]
    place = Rotation.from_quat(pose["quaternion"]).inv().apply([900.0, -4.0, 3.0])
    for number, gap in ((901, 0.0), (902, 150.0)):
        right, down, ahead = place - Rotation.from_quat(pose["quaternion"]).inv().apply(
            pose["position"]
        )
        signs.append(sign(number, (right, down, ahead + gap)))
    ours = evaluated(tmp_path, signs, truth)
    theirs = reference(tmp_path, "--truth", "truth.json")
    assert ours.found_count > 2
    assert ours.false
    assert ours.missed
    assert_alike_beside(ours, theirs, {"backs"})
    assert Duplicate("drive-0902", 99, "drive-0901") in ours.duplicates
    assert {row.sign_id for row in ours.duplicates} <= {sign.sign_id for sign in ours.false}


@needs_reference
@pytest.mark.parametrize("seed", range(3))
def test_figures_of_real_drives_are_those_of_the_reference(tmp_path, seed):
    signs, observations, marks = random_real(np.random.default_rng(seed))
    apart = [900, 900, 920, 920]
    marks["signs"].append({"id": "R99", "wanted": True, "boxes": [{"i": 3, "box": apart}]})
    signs += [
        sign(number, ON_IT, best_frame=3, best_box=[900.0, 900.0, 920.0, 920.0 + number - 901])
        for number in (901, 902)
    ]
    ours = evaluated_on_labels(tmp_path, signs, observations, marks)
    theirs = reference(tmp_path, "--labels", "labels.json")
    assert ours.found
    assert ours.false
    assert_alike_beside(ours, theirs, {"touching", "kinds"})
    assert Duplicate("drive-0902", "R99", "drive-0901") in ours.duplicates
    assert not {row.sign_id for row in ours.duplicates} & {sign.sign_id for sign in ours.false}


ONLY_OURS = {
    "recall_interval",
    "precision_interval",
    "images",
    "false_per_100_images",
    "false_per_100_images_interval",
    "learned_by",
    "duplicates",
    "reliability",
    "causes",
}


def assert_alike_beside(ours, theirs, more):
    """Every figure of the reference is the same here; beside it stands what the reference does not know."""
    figures = json.loads(json.dumps(ours.to_json()))
    assert figures.keys() - theirs.keys() == ONLY_OURS | more
    assert_alike({key: figures[key] for key in theirs}, theirs)


def reference(tmp_path, option, file):
    command = [str(REFERENCE), str(tmp_path / "out"), option, str(tmp_path / file)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [*command, "--json", str(tmp_path / "reference.json")])
        with pytest.raises(SystemExit) as end:
            runpy.run_path(str(REFERENCE), run_name="__main__")
    assert end.value.code == 0
    figures = json.loads((tmp_path / "reference.json").read_text())
    return figures


def assert_alike(ours, theirs, where=""):
    """Equal, but for the last rounded place of a number."""
    if isinstance(theirs, dict):
        assert (
            list(ours) == list(theirs)
            if where.endswith("confusion")
            else ours.keys() == theirs.keys()
        ), where
        for key in theirs:
            assert_alike(ours[key], theirs[key], f"{where}.{key}")
    elif isinstance(theirs, list):
        assert len(ours) == len(theirs), where
        for i, (a, b) in enumerate(zip(ours, theirs, strict=True)):
            assert_alike(a, b, f"{where}[{i}]")
    elif isinstance(theirs, float):
        assert math.isclose(ours, theirs, abs_tol=1.01e-4), (where, ours, theirs)
    else:
        assert ours == theirs, where


def random_rendered(rng):
    frames = []
    for i in range(12):
        turn = rng.normal((-0.5, 0.5, -0.5, 0.5), 0.02)
        frames.append(frame(i, 8.0 * i, tuple((turn / np.linalg.norm(turn)).tolist())))
    panels = []
    for number in range(1, 31):
        views = []
        for i in rng.choice(12, rng.integers(2, 10), replace=False):
            x, y, w, h = (*rng.uniform(0, 1000, 2), *rng.uniform(6, 60, 2))
            front = rng.random() < 0.85
            seen = float(rng.uniform(0.2, 1)) if front else None
            box = [x, y, x + w, y + h]
            views.append(
                {
                    "frame": int(i),
                    "box": box,
                    "side": "front" if front else "back",
                    "visible_fraction": seen,
                }
            )
        centre = (rng.uniform(20, 130), rng.uniform(-12, 12), rng.uniform(1, 4))
        panels.append(
            panel(
                number,
                centre,
                color=str(rng.choice(COLORS)),
                shape=str(rng.choice(SHAPES)),
                width_m=float(rng.uniform(0.3, 2)),
                faces_travel=bool(rng.random() < 0.9),
                frames=views,
            )
        )
    return [random_sign(rng, i, panels, frames) for i in range(35)], {
        "frames": frames,
        "signs": panels,
        "distractors": [
            {
                "id": f"d{i}",
                "kind": "board",
                "frames": [
                    {"frame": int(rng.integers(12)), "box": [0, 0, *rng.uniform(200, 900, 2)]}
                ],
            }
            for i in range(20)
        ],
    }


def random_sign(rng, number, panels, frames):
    """A report of some panel, near it or far off, with some figures unknown; frame 12 has no pose."""
    target = panels[int(rng.integers(len(panels)))]
    best = int(rng.integers(13))
    view = frames[min(best, 11)]
    actual = (
        Rotation.from_quat(view["quaternion"])
        .inv()
        .apply(np.subtract(target["centre"], view["position"]))
    )
    right, down, ahead = actual + rng.normal(0, rng.choice([0.1, 1.0]), 3)
    left, top, width, height = (*rng.uniform(0, 1000, 2), *rng.uniform(6, 60, 2))
    unknown = rng.random(4) < 0.2
    return sign(
        number,
        (float(right), float(down), float(ahead)),
        status=str(rng.choice(["sign", "sign", "sign", "back", "uncertain"])),
        color=None
        if unknown[0]
        else str(target["color"] if rng.random() < 0.7 else rng.choice(COLORS)),
        shape=str(target["shape"] if rng.random() < 0.7 else rng.choice(SHAPES)),
        best_frame=best,
        best_box=[float(left), float(top), float(left + width), float(top + height)],
        panel_width_m=None if unknown[1] else float(rng.uniform(0.3, 2)),
        bottom_m=None if unknown[2] else float(rng.uniform(0, 3)),
        sigma_up_m=None if unknown[3] else float(rng.choice([0.0, 0.1, 1.0])),
        sigma_along_m=float(rng.uniform(0.05, 2)),
    )


def random_real(rng):
    def box():
        x, y, w, h = (*rng.uniform(0, 60, 2), *rng.uniform(5, 40, 2))
        return [round(float(v), 1) for v in (x, y, x + w, y + h)]

    marks = labels(
        *(
            {
                "id": f"R{i}",
                "wanted": bool(rng.random() < 0.6),
                "boxes": [{"i": int(f), "box": box()} for f in rng.choice(40, 2, replace=False)],
            }
            for i in range(15)
        ),
        distractors=tuple(
            {"what": f"thing {i}", "source_frame": int(rng.integers(160)), "box": box()}
            for i in range(10)
        ),
    )
    marks["distractors"].append({"what": "followed thing", "boxes": [{"i": 3, "box": box()}]})
    signs = [
        sign(
            i,
            ON_IT,
            status=str(rng.choice(["sign", "sign", "back"])),
            best_frame=int(rng.integers(40)),
            best_box=box(),
        )
        for i in range(20)
    ]
    observations = [
        {
            "frame": int(rng.integers(40)),
            "box": box(),
            "sign_id": f"drive-{rng.integers(25):04}" if rng.random() < 0.8 else None,
        }
        for _ in range(80)
    ]
    return signs, observations, marks
