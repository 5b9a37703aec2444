"""The pages on seeing: how far a face went, what is true of rows by confidence, other seeds."""

import numpy as np
import pytest
from scipy.stats import binomtest

from wayside.pipeline.evaluation import ConfidenceBin

FACE = [10.0, 10.0, 30.0, 30.0]


@pytest.fixture(scope="module")
def levels(load):
    return load("reached")


@pytest.fixture(scope="module")
def seeing(load):
    return load("seeing")


@pytest.fixture(scope="module")
def confidence(load):
    return load("confidence")


@pytest.mark.parametrize(
    ("boxes", "verdicts", "level"),
    [
        ([], [], "NOWHERE"),
        ([[100, 10, 120, 30]], ["sign"], "NOWHERE"),
        ([[10, 10, 30, 29]], ["size"], "CANDIDATE"),
        ([[10, 10, 30, 29], [11, 10, 30, 30]], ["size", "score"], "CLASSIFIED"),
        ([[10, 10, 30, 29], [11, 10, 30, 30]], ["overlap", "score"], "PASSED"),
        ([[10, 10, 30, 29]], ["unmatched"], "KEPT"),
        ([[10, 10, 30, 29], [11, 10, 30, 30]], ["sign", "overlap"], "SIGN"),
    ],
)
def test_a_face_went_as_far_as_the_best_box_on_it(levels, boxes, verdicts, level):
    table = np.array(boxes, np.float64).reshape(-1, 4)
    assert levels.reached(FACE, table, np.array(verdicts, str)) == getattr(levels, level)


def test_shares_count_what_went_at_least_so_far(levels):
    assert levels.shares([0, 1, 3, 5], (1, 3, 5)) == ["4", "75 %", "50 %", "25 %"]
    assert levels.shares([], (1, 3)) == ["0", "-", "-"]


def test_shares_of_real_faces_stand_with_their_interval(levels):
    # Wilson of 3 in 4: 0.301 to 0.954; exact for all of 4: 0.398 to 1
    cells = levels.shares([0, 1, 3, 5], (0, 1), sure=True)
    assert cells == ["4", "100 % (40 to 100)", "75 % (30 to 95)"]
    assert levels.shares([], (1,), sure=True) == ["0", "-"]


def test_a_value_on_an_edge_is_in_the_bin_above_it(levels):
    edges = (10, 12, 15)
    names = levels.bin_names(edges, "px")
    assert [levels.bin_of(v, edges) for v in (9.9, 10.0, 14.9, 15.0, 900.0)] == [-1, 0, 1, 2, 2]
    assert names == ["10-12 px", "12-15 px", "15 px and more"]


def panel(number, ahead):
    views = [{"frame": k, "side": "front", "box": FACE, "visible_fraction": 1.0} for k in range(3)]
    return {
        "id": number,
        "kind": "stop",
        "color": "red",
        "shape": "octagon",
        "width_m": 0.75,
        "height_m": 0.75,
        "bottom_m": 2.0,
        "faces_travel": True,
        "centre": [0.0, 0.0, ahead],
        "frames": views,
    }


def row(name, ahead, confidence):
    values = {"sign_id": name, "confidence": confidence, "best_frame": 0, "best_box": FACE}
    values |= {"right_m": 0.0, "down_m": 0.0, "ahead_m": ahead, "color": "red", "shape": "octagon"}
    sizes = dict.fromkeys(("panel_width_m", "panel_height_m", "bottom_m"), 0.75)
    return values | sizes | dict.fromkeys(("sigma_lateral_m", "sigma_up_m", "sigma_along_m"), 0.1)


@pytest.fixture
def result():
    frame = {"index": 0, "position": [0.0, 0.0, 0.0], "quaternion": [0.0, 0.0, 0.0, 1.0]}
    truth = {"frames": [frame], "signs": [panel(1, 20.0), panel(2, 60.0)], "distractors": []}
    # the second row is nearer to panel 1 than the first, but less sure
    return [
        row("a", 20.5, 0.97),
        row("b", 20.0, 0.35),
        row("c", 60.0, 0.32),
        row("d", 99.0, 0.999),
    ], truth


def test_a_row_vies_for_a_panel_only_with_rows_as_sure_as_it(confidence, result):
    bins = {one.low: one for one in confidence.reliability([result])}
    assert (bins[0.95].rows, bins[0.95].right) == (1, 1)
    assert (bins[0.3].rows, bins[0.3].right) == (2, 2)
    assert (bins[0.99].rows, bins[0.99].right) == (1, 0)
    assert sum(one.rows for one in bins.values()) == 4
    assert bins[0.3].mean == pytest.approx(0.335)


def test_a_higher_setting_reports_fewer_rows(confidence, result):
    low, high = (confidence.evaluated_at([result], at) for at in (0.3, 0.9))
    assert (low.found_count, high.found_count, low.wanted) == (2, 1, 2)
    assert confidence.cells(high) == ["1 of 2", "1", "0.500", "0.500"]


def test_the_gap_is_that_of_each_bin_by_its_rows(confidence):
    bins = [ConfidenceBin(0.4, 0.5, 3, 1, 0.4), ConfidenceBin(0.9, 1.0, 1, 1, 0.9)]
    assert confidence.calibration_error(bins) == pytest.approx((abs(1.2 - 1) + 0.1) / 4)


@pytest.mark.parametrize(("right", "rows"), [(0, 1), (3, 4), (98, 99)])
def test_the_interval_of_a_share_is_that_of_scipy(right, rows, load):
    found = load("seeing_plot").wilson(right, rows)
    interval = binomtest(right, rows).proportion_ci(0.6826894921, "wilson")
    assert found == pytest.approx((interval.low, interval.high), abs=1e-6)


def test_the_image_has_room_for_bins_without_faces(load):
    shown = load("seeing_plot").draw(["10-12 px", "12 px and more"], [[5, 0], []], [(0.9, 1, 2)])
    assert shown.dtype == np.uint8
    assert shown.std() > 0


def test_a_fresh_drive_has_another_name_and_seed_and_nothing_else_new(seeing):
    text = (seeing.ROOT / "recordings" / "drives" / "specs" / "town.toml").read_text()
    changed = [
        (a, b)
        for a, b in zip(text.splitlines(), seeing.reseeded(text, "town").splitlines(), strict=True)
        if a != b
    ]
    assert changed == [('name = "town"', 'name = "fresh_town"'), ("seed = 53", "seed = 9774")]


def test_only_the_front_of_a_tall_and_visible_face_counts(seeing):
    good = {"frame": 0, "side": "front", "box": [0, 0, 9, 12], "visible_fraction": 0.6}
    views = [good, good | {"side": "back"}, good | {"box": [0, 0, 9, 9]}]
    views.append(good | {"visible_fraction": 0.4})
    signs = [{"faces_travel": True, "frames": views}, {"faces_travel": False, "frames": [good]}]
    assert list(seeing.fronts({"signs": signs})) == [(signs[0], good)]
