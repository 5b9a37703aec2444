"""The page on seeing: how far a face went, and what is true of rows by confidence."""

import numpy as np
import pytest

FACE = [10.0, 10.0, 30.0, 30.0]


@pytest.fixture(scope="module")
def seeing(load):
    return load("seeing")


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
def test_a_face_went_as_far_as_the_best_box_on_it(seeing, boxes, verdicts, level):
    table = np.array(boxes, np.float64).reshape(-1, 4)
    assert seeing.reached(FACE, table, np.array(verdicts, str)) == getattr(seeing, level)


def panel(number, ahead):
    views = [{"frame": k, "side": "front", "box": FACE, "visible_fraction": 1.0} for k in range(3)]
    look = {"kind": "stop", "color": "red", "shape": "octagon", "faces_travel": True}
    size = {"width_m": 0.75, "height_m": 0.75, "bottom_m": 2.0}
    return look | size | {"id": number, "centre": [0.0, 0.0, ahead], "frames": views}


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
    rows = [("a", 20.5, 0.97), ("b", 20.0, 0.35), ("c", 60.0, 0.32), ("d", 99.0, 0.999)]
    return [row(*one) for one in rows], truth


def test_a_row_vies_for_a_panel_only_with_rows_as_sure_as_it(seeing, result):
    bins = {one.low: one for one in seeing.reliability([result])}
    assert (bins[0.95].rows, bins[0.95].right) == (1, 1)
    assert (bins[0.3].rows, bins[0.3].right) == (2, 2)
    assert (bins[0.99].rows, bins[0.99].right) == (1, 0)
    assert sum(one.rows for one in bins.values()) == 4
    assert bins[0.3].mean == pytest.approx(0.335)


def test_a_higher_setting_reports_fewer_rows(seeing, result):
    low, high = (seeing.evaluated_at([result], at) for at in (0.3, 0.9))
    assert (low.found_count, high.found_count, low.wanted) == (2, 1, 2)
    assert (len(low.false), len(high.false)) == (2, 1)


def test_only_the_front_of_a_tall_and_visible_face_counts(seeing):
    good = {"frame": 0, "side": "front", "box": [0, 0, 9, 12], "visible_fraction": 0.6}
    views = [good, good | {"side": "back"}, good | {"box": [0, 0, 9, 9]}]
    views.append(good | {"visible_fraction": 0.4})
    signs = [{"faces_travel": True, "frames": views}, {"faces_travel": False, "frames": [good]}]
    assert list(seeing.fronts({"signs": signs})) == [(signs[0], good)]
