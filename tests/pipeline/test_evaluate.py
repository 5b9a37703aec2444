"""Evaluation of a result against the truth, compared with the reference scorer if it is available."""

import json
import runpy
import sys
from operator import itemgetter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from wayside.pipeline.evaluation.compare import evaluate, format_evaluation, write_evaluation
from wayside.pipeline.evaluation.figures import Backs, Duplicate, KindCount, together
from wayside.pipeline.labels.box_matching import same_thing
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError, OutputError

from .results import observation_row, sign_row, write_tables

REFERENCE = Path(__file__).parents[3] / "shared" / "tools" / "score.py"
DEMO = Path(__file__).parents[2] / "recordings" / "demo.truth.json"
IMAGES = 50
"""Images of a result made for the test, all used."""
BOX = [100.0, 100.0, 120.0, 120.0]


def frame(index, x, quaternion=(-0.5, 0.5, -0.5, 0.5)):
    return {"index": index, "position": [x, 0.0, 2.0], "quaternion": list(quaternion)}


def view(index, box=BOX, side="front", visible=1.0):
    return {"frame": index, "box": box, "side": side, "visible_fraction": visible}


def panel(number, centre, **change):
    looks = {"kind": "stop", "color": "red", "shape": "octagon", "faces_travel": True}
    sizes = {"width_m": 0.75, "height_m": 0.75, "bottom_m": 1.5, "lateral_m": 4, "station_m": 30}
    views = [view(i, [100, 100, 120, 120 + i]) for i in range(3)]
    return {"id": number, "centre": list(centre), "frames": views} | looks | sizes | change


def sign(number, place, **change):
    looks = {"color": "red", "shape": "octagon", "best_frame": 0, "best_box": BOX}
    sizes = {"panel_width_m": 0.75, "panel_height_m": 0.75, "bottom_m": 1.5}
    sigmas = dict.fromkeys(("sigma_lateral_m", "sigma_up_m", "sigma_along_m"), 0.1)
    at = dict(zip(("right_m", "down_m", "ahead_m"), place, strict=True))
    return sign_row(f"drive-{number:04}", **looks | sizes | sigmas | at | change)


def evaluated(tmp_path, signs, truth, observations=(), images=IMAGES):
    rows = [
        observation_row(number=0, **{"verdict": "sign" if row["sign_id"] else "score"} | row)
        for row in sorted(observations, key=itemgetter("frame"))
    ]
    frames = [{"frame": i, "log_time_ns": i, "status": "used"} for i in range(images)]
    write_tables(tmp_path / "out", signs, rows, frames)
    (tmp_path / "truth.json").write_text(truth if isinstance(truth, str) else json.dumps(truth))
    return evaluate(tmp_path / "out", tmp_path / "truth.json")


FRAMES = [frame(i, 8.0 * i) for i in range(4)]
AT_30_M = panel(1, (30.0, -4.0, 3.0))
ON_IT = (4.0, -1.0, 30.0)


@pytest.fixture
def rendered(tmp_path):
    """Evaluates signs, by default against one panel 30 m ahead."""

    def figures(*signs, panels=(AT_30_M,), **more):
        return evaluated(tmp_path, list(signs), {"frames": FRAMES, "signs": list(panels)} | more)

    return figures


def ids(rows):
    return [row["sign_id"] for row in rows]


def test_errors_are_told_apart_by_axis_of_the_camera(rendered):
    sigmas = {"sigma_lateral_m": 0.2, "sigma_up_m": 0.4, "sigma_along_m": 0.3}
    evaluation = rendered(sign(1, (4.3, -1.2, 31.0), **sigmas))
    medians = {name: value.median for name, value in evaluation.error_m.items()}
    total = pytest.approx(1.063, abs=1e-3)
    assert medians == {"lateral": 0.3, "up": 0.2, "along": 1.0, "total": total}
    within = {name: (value.one, value.two) for name, value in evaluation.sigma_share.items()}
    assert within == {"lateral": (0.0, 1.0), "up": (1.0, 1.0), "along": (0.0, 0.0)}


def test_a_panel_at_its_true_place_has_no_error_and_what_is_unknown_is_left_out(rendered):
    unknown = dict.fromkeys(("panel_width_m", "bottom_m", "sigma_up_m"))
    evaluation = rendered(sign(1, ON_IT, sigma_along_m=0.0, **unknown))
    assert (evaluation.recall, evaluation.precision) == (1.0, 1.0)
    assert evaluation.error_m["total"].median == pytest.approx(0, abs=1e-4)
    assert evaluation.class_right("color") == evaluation.class_right("shape") == 1.0
    assert (evaluation.size_error("width").n, evaluation.bottom_error_m.n) == (0, 0)
    assert (evaluation.sigma_share["up"].n, evaluation.sigma_share["along"].n) == (0, 0)
    assert evaluation.size_error("height").median == 0.0


@pytest.mark.parametrize(
    ("right", "ahead", "best_frame", "found"),
    [
        (5.49, 30.0, 0, 1),
        (5.6, 30.0, 0, 0),
        (4.0, 33.0, 0, 1),
        (4.0, 33.2, 0, 0),
        (4.0, 30.0, 77, 0),
    ],
)
def test_a_match_reaches_as_far_as_said_and_needs_a_pose(rendered, right, ahead, best_frame, found):
    evaluation = rendered(sign(1, (right, -1.0, ahead), best_frame=best_frame))
    assert evaluation.found_count == found
    assert len(evaluation.missed) == len(evaluation.false) == 1 - found


def test_a_panel_is_found_by_the_nearest_row_and_one_more_on_its_face_is_a_duplicate(rendered):
    far = sign(1, (4.0, -1.0, 41.0), best_box=[101.0, 100.0, 121.0, 121.0])
    near = sign(3, (4.5, -1.0, 30.0), best_box=[500.0, 500.0, 520.0, 520.0])
    evaluation = rendered(far, sign(2, ON_IT), near)
    assert [(one.sign["sign_id"], one.panel["id"]) for one in evaluation.found] == [
        ("drive-0002", 1)
    ]
    assert evaluation.duplicates == (Duplicate("drive-0001", 1, "drive-0002"),)
    assert ids(evaluation.false) == ["drive-0001", "drive-0003"]
    assert evaluation.precision == pytest.approx(1 / 3)
    text = format_evaluation(evaluation)
    assert "false      2       duplicates 1, others 1; 4.00 per 100 images" in text
    assert "drive-0001  of drive-0002, on sign 1" in text
    assert text.count("drive-0001") == 1


@pytest.mark.parametrize(
    ("row", "found"),
    [
        (sign(1, (4.0, -1.0, 41.0)), False),
        (sign(1, (1.0, 0.0, 3.0), best_frame=3), True),
        (sign(1, (4.0, 0.0, 30.0), best_box=[100.0, 122.0, 120.0, 140.0]), True),
    ],
    ids=["on a face that no row found", "on what hides a found face", "beside a found face"],
)
def test_a_row_that_is_false_is_not_always_a_duplicate(rendered, row, found):
    hidden = view(3, visible=0.2)
    panel = AT_30_M | {"frames": [*AT_30_M["frames"], hidden]}
    evaluation = rendered(row, *[sign(2, ON_IT)] * found, panels=[panel])
    assert (evaluation.duplicates, len(evaluation.false)) == ((), 1)


@pytest.mark.parametrize(
    "change",
    [
        {"faces_travel": False},
        {"frames": AT_30_M["frames"][:2]},
        {"frames": [view(i, [0, 0, 9, 9.9]) for i in range(3)]},
        {"frames": [view(i, visible=0.4) for i in range(3)]},
    ],
    ids=["turned away", "too few images", "too small", "hidden"],
)
def test_a_panel_that_need_not_be_found_counts_as_neither(rendered, change):
    evaluation = rendered(sign(1, ON_IT), panels=[AT_30_M | change])
    assert (evaluation.wanted, evaluation.found_count, len(evaluation.false)) == (0, 0, 0)
    assert (evaluation.recall, evaluation.precision) == (1.0, 1.0)


def test_backs_are_counted_apart_right_where_a_panel_is_seen_from_behind(rendered):
    views = [view(i, side="back", visible=None) for i in range(3)]
    behind = AT_30_M | {"id": 4, "faces_travel": False, "frames": views}
    front = AT_30_M | {"id": 5, "centre": [40.0, 0.0, 2.0]}
    on_back, on_nothing = sign(1, ON_IT, status="back"), sign(2, (0, 0, 9), status="back")
    evaluation = rendered(on_back, on_nothing, panels=[behind, front])
    assert (evaluation.backs, evaluation.false) == (Backs(2, 1, 1), ())
    assert together([evaluation, evaluation]).backs == Backs(4, 2, 2)
    assert "backs      1 of 2 right, 1 in view" in format_evaluation(evaluation)
    on_it = rendered(sign(1, ON_IT), panels=[behind])
    assert [row["cause"] for row in on_it.false] == ["sign stop 4"]


def test_a_false_sign_names_the_distractor_it_lies_on(rendered):
    boards = [
        {"id": "b-7", "kind": "billboard", "frames": [{"frame": 0, "box": [90, 90, 150, 150]}]}
    ]
    elsewhere = sign(2, (9, 0, 50), best_box=[500.0, 500.0, 520.0, 520.0])
    evaluation = rendered(sign(1, (9, 0, 50)), elsewhere, panels=(), distractors=boards)
    assert [row["cause"] for row in evaluation.false] == ["distractor billboard b-7", "unknown"]
    assert evaluation.false[0]["ahead_m"] == 50


def test_rows_are_counted_by_their_confidence_uncertain_ones_among_them(rendered):
    evaluation = rendered(
        sign(1, ON_IT, confidence=0.95),
        sign(2, (9, 0, 50), confidence=0.99),
        sign(3, (9, 9, 50), confidence=1.0),
        sign(4, (9, 9, 40), confidence=0.3, status="uncertain"),
        sign(5, (9, 9, 40), confidence=0.9, status="back"),
        sign(6, (9, 9, 30), confidence=None),
    )
    assert ids(evaluation.false) == ["drive-0002", "drive-0003", "drive-0006"]
    counted = {one.name: (one.rows, one.right) for one in evaluation.reliability}
    assert counted == {"0 to 0.5": (1, 0), "0.9 to 0.99": (1, 1), "0.99 to 1": (2, 0)}
    assert evaluation.reliability[-1].mean == pytest.approx(0.995)
    twice = together([evaluation, evaluation]).reliability
    assert [one.rows for one in twice] == [2 * one.rows for one in evaluation.reliability]
    assert "0.9 to 0.99              1   0.950           1   1.000   0.025 to 1.000" in (
        format_evaluation(evaluation)
    )
    assert evaluation.to_json()["reliability"][0]["rows"] == 1


def test_the_table_for_a_person_holds_every_part(rendered):
    panels = AT_30_M, panel(2, (60.0, 5.0, 3.0), kind="yield")
    evaluation = rendered(sign(1, ON_IT, color="orange"), sign(2, (0, 0, 9)), panels=panels)
    text = format_evaluation(evaluation)
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


def labels(*signs, distractors=()):
    things = {"signs": list(signs), "distractors": list(distractors)}
    return {"log": "d.mcap", "stride": 4, "frames": []} | things


LABEL = {"id": "R1", "wanted": True, "boxes": [{"i": 5, "box": BOX}]}
SEEN = {"sign_id": "drive-0001", "frame": 5, "box": [101.0, 101.0, 121.0, 121.0]}


@pytest.fixture
def real(tmp_path):
    """Evaluates signs against labels, by default one in frame 5."""

    def figures(*signs, seen=(), marks=(LABEL,), **more):
        return evaluated(tmp_path, list(signs), labels(*marks, **more), seen)

    return figures


def test_a_label_is_found_by_an_observation_of_a_reported_sign_and_counts_if_it_is_wanted(real):
    evaluation = real(sign(1, ON_IT), seen=[SEEN])
    assert (evaluation.found, evaluation.missed, evaluation.false) == (("R1",), (), ())
    rows = [sign(1, ON_IT, confidence=0.4, status="uncertain"), sign(2, ON_IT, confidence=0.45)]
    (stated,) = real(*rows, seen=[SEEN]).reliability
    assert (stated.rows, stated.right, stated.mean) == (2, 1, pytest.approx(0.425))
    evaluation = real(seen=[SEEN | {"sign_id": None}])
    assert (evaluation.recall, evaluation.missed, evaluation.precision) == (0.0, ("R1",), 1.0)
    evaluation = real(sign(1, ON_IT, best_frame=5), marks=[LABEL | {"wanted": False}])
    assert (evaluation.wanted, evaluation.right, evaluation.false) == (0, 1, ())


def test_a_second_row_on_a_label_is_a_duplicate_and_not_false(real):
    rough = sign(2, ON_IT, best_frame=5, best_box=[98.0, 97.0, 123.0, 125.0])
    evaluation = real(rough, sign(1, ON_IT, best_frame=5))
    assert evaluation.duplicates == (Duplicate("drive-0002", "R1", "drive-0001"),)
    assert (evaluation.right, evaluation.false, evaluation.precision) == (2, (), 1.0)


def test_two_rows_on_two_touching_labels_are_none_of_them_a_duplicate(real):
    lower = {"id": "R2", "wanted": True, "boxes": [{"i": 5, "box": [100, 112, 120, 132]}]}
    both = [
        sign(number, ON_IT, best_frame=5, best_box=[100.0, top, 120.0, top + 20])
        for number, top in ((1, 101.0), (2, 108.0))
    ]
    evaluation = real(*both, marks=[LABEL, lower])
    assert (evaluation.found, evaluation.duplicates) == (("R1", "R2"), ())


def test_recall_is_told_by_kind_where_labels_name_kinds(real):
    marks = [
        LABEL | {"kind": "parking plate"},
        LABEL | {"id": "R2", "kind": "parking plate", "boxes": []},
        LABEL | {"id": "R3", "boxes": []},
        LABEL | {"id": "R4", "kind": "guide", "wanted": False},
    ]
    evaluation = real(sign(1, ON_IT, best_frame=5), marks=marks)
    assert evaluation.kinds == (KindCount("parking plate", 2, 1), KindCount("other", 1, 0))
    both = together([evaluation, evaluation])
    assert both.kinds == (KindCount("parking plate", 4, 2), KindCount("other", 2, 0))
    assert (both.wanted, both.found_count, both.images) == (6, 2, 2 * IMAGES)
    assert "parking plate                                     2      1   0.500" in (
        format_evaluation(evaluation)
    )


def test_every_share_of_a_real_drive_stands_with_its_interval_and_what_was_missed_is_listed(real):
    rows = sign(1, ON_IT, best_frame=5), sign(2, ON_IT, best_frame=9)
    lines = format_evaluation(real(*rows, marks=[LABEL, LABEL | {"id": "R2", "boxes": []}]))
    # Wilson of one in two; Garwood of one: 0.0253 and 5.572, in 50 images
    recall, precision, false, *rest = lines.splitlines()
    assert recall == "recall     0.500   1 of 2 found, 95 %: 0.095 to 0.905"
    assert precision.startswith("precision  0.500   1 of 2 rows on a label, 95 %: 0.095 to 0.905")
    assert false == "false      1       on no label; 2.00 per 100 images, 95 %: 0.05 to 11.14"
    assert rest[-1].startswith("  R2")


def test_a_result_says_whether_its_models_were_learned_from_the_log(real, tmp_path):
    assert "learned" not in format_evaluation(real())
    for models, words in (([], "no model"), (["box", "network"], "box, network")):
        (tmp_path / "out" / "run.json").write_text(json.dumps({"learned_from_log": models}))
        evaluation = evaluate(tmp_path / "out", tmp_path / "truth.json")
        assert evaluation.learned_by == tuple(models)
        assert f"learned    {words} of this run from this log" in format_evaluation(evaluation)


def test_a_false_sign_on_a_boxed_distractor_says_which(real):
    flag = {"what": "advertising flag", "source_frame": 32, "box": BOX}
    rows = [sign(1, ON_IT, best_frame=8), sign(2, ON_IT, best_frame=9)]
    evaluation = real(*rows, marks=(), distractors=(flag,))
    assert [row["cause"] for row in evaluation.false] == ["advertising flag", "unlabelled"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "wayside run"),
        ("sign_id\n", r"signs\.parquet cannot be read"),
        (pa.table({"sign_id": ["a"], "status": ["sign"]}), "lacks the column best_frame"),
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
        ("{", "not JSON"),
        ('{"signs":' * 50_000, "not JSON"),
        ("[]", "neither the truth"),
        ('{"signs": []}', "neither the truth"),
        ('{"signs": [{"id": 1}], "frames": []}', "not as expected"),
    ],
)
def test_a_wrong_truth_file_is_refused(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        evaluated(tmp_path, [], text)
    with pytest.raises(InputError, match="cannot be read"):
        evaluate(tmp_path / "out", tmp_path / "none.json")


def test_a_result_without_images_is_evaluated_and_figures_that_cannot_be_written_say_so(tmp_path):
    evaluation = evaluated(tmp_path, [], {"frames": [], "signs": []}, images=0)
    assert (evaluation.images, evaluation.false_per_100_images) == (0, None)
    with pytest.raises(OutputError, match="the file cannot be written: No such file"):
        write_evaluation(evaluation, tmp_path / "missing" / "figures.json")


def test_a_small_box_inside_a_large_one_is_the_same_thing_up_to_a_factor_of_five():
    assert same_thing([40, 40, 60, 60], [30, 30, 70, 70])
    assert not same_thing([40, 40, 60, 60], [0, 0, 100, 100])
    assert not same_thing([0, 0, 10, 10], [20, 20, 30, 30])


ONLY_OURS = {
    *("recall_interval", "precision_interval", "images", "learned_by", "duplicates"),
    *("false_per_100_images", "false_per_100_images_interval", "reliability", "causes"),
}


@pytest.mark.skipif(
    not REFERENCE.is_file(), reason="the reference scorer is not beside this checkout"
)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("option", "least", "more"), [("--truth", 2, {"backs"}), ("--labels", 1, {"touching", "kinds"})]
)
def test_figures_are_those_of_the_reference(tmp_path, seed, option, least, more):
    """But for their last place, with `least` signs found; `more` is not known there."""
    make = random_rendered if option == "--truth" else random_real
    ours = evaluated(tmp_path, *make(np.random.default_rng(seed)))
    assert ours.found_count >= least
    assert ours.false
    assert ours.missed
    command = [str(REFERENCE), str(tmp_path / "out"), option, str(tmp_path / "truth.json")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [*command, "--json", str(tmp_path / "reference.json")])
        with pytest.raises(SystemExit) as end:
            runpy.run_path(str(REFERENCE), run_name="__main__")
    assert end.value.code == 0
    text = (tmp_path / "reference.json").read_text()
    theirs = json.loads(text, parse_float=lambda one: pytest.approx(float(one), abs=1.01e-4))
    figures = json.loads(json.dumps(ours.to_json()))
    assert figures.keys() - theirs.keys() == ONLY_OURS | more
    assert {key: figures[key] for key in theirs} == theirs
    for key in theirs:
        if key.endswith("confusion"):
            assert list(figures[key]) == list(theirs[key])


def random_box(rng, reach=1000, most=60):
    x, y, w, h = (*rng.uniform(0, reach, 2), *rng.uniform(6, most, 2))
    return np.round([x, y, x + w, y + h], 1).tolist()


LOOKS = {"color": COLORS, "shape": SHAPES}


def random_rendered(rng):
    """The demo drive, and reports of its panels, near or far off, some in an image without a pose."""
    truth = json.loads(DEMO.read_text())
    return [random_sign(rng, number, truth) for number in range(35)], truth


def random_sign(rng, number, truth):
    target = truth["signs"][int(rng.integers(len(truth["signs"])))]
    pose = truth["frames"][int(rng.integers(len(truth["frames"])))]
    figures = {look: str(rng.choice([target[look], *of])) for look, of in LOOKS.items()}
    figures |= {"panel_width_m": float(rng.uniform(0.3, 2)), "bottom_m": float(rng.uniform(0, 3))}
    figures |= {"sigma_up_m": float(rng.choice([0.0, 0.1, 1.0]))}
    given = {name: value if rng.random() < 0.8 else None for name, value in figures.items()}
    off, turn = rng.normal(0, rng.choice([0.1, 1.0]), 3), Rotation.from_quat(pose["quaternion"])
    near = turn.apply(np.subtract(target["centre"], pose["position"]), inverse=True) + off
    given |= {"status": str(rng.choice(["sign", "sign", "sign", "back", "uncertain"]))}
    given |= {"best_frame": 77 if rng.random() < 0.1 else pose["index"]}
    given |= {"best_box": random_box(rng), "sigma_along_m": float(rng.uniform(0.05, 2))}
    return sign(number, near.tolist(), **given)


def random_real(rng):
    marks = [{"id": f"R{i}", "wanted": bool(rng.random() < 0.6)} for i in range(15)]
    for mark in marks:
        seen = rng.choice(40, 2).tolist()
        mark["boxes"] = [{"i": frame, "box": random_box(rng, 60, 40)} for frame in seen]
    things = [
        {"what": f"thing {i}", "source_frame": int(rng.integers(160)), "box": random_box(rng, 60)}
        for i in range(10)
    ]
    things.append({"what": "followed thing", "boxes": [{"i": 3, "box": random_box(rng, 60)}]})
    signs = [
        sign(i, ON_IT, best_frame=int(rng.integers(40)), best_box=random_box(rng, 60, 40))
        | {"status": str(rng.choice(["sign", "sign", "back"]))}
        for i in range(20)
    ]
    names = [None if rng.random() < 0.2 else f"drive-{rng.integers(25):04}" for _ in range(80)]
    seen = [
        {"frame": int(rng.integers(40)), "box": random_box(rng, 60, 40), "sign_id": name}
        for name in names
    ]
    return signs, labels(*marks, distractors=things), seen
