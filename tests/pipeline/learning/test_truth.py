"""What a rendered drive says that its images show, and the labels of boxes by it."""

import numpy as np
import pytest

from wayside.pipeline.learning.labelled import FACE_PX, NEITHER, OFF, ON
from wayside.pipeline.learning.truth import (
    box_labels,
    face_labels,
    read_truth,
    sign_positions,
    views_by_frame,
)
from wayside.schemas.errors import InputError

SIGN, PLAQUE = [100, 100, 140, 140], [105, 141, 135, 156]


def labels_of(boxes, faces=(SIGN, PLAQUE), is_example=None):
    is_example = [True] * len(faces) if is_example is None else is_example
    return face_labels(
        np.array(boxes, np.float32), np.array(faces, np.float64), np.array(is_example)
    ).tolist()


def test_a_tight_box_is_on_and_a_far_one_off():
    assert labels_of([SIGN, [101, 101, 139, 140], [300, 100, 340, 140]]) == [ON, ON, OFF]


def test_beside_a_tight_box_a_loose_one_is_no_example():
    loose = [90, 100, 145, 150]
    assert labels_of([SIGN, loose], [SIGN]) == [ON, NEITHER]


def test_without_a_tight_box_a_loose_one_is_on():
    assert labels_of([[90, 100, 145, 150]], [SIGN]) == [ON]


def test_a_part_of_a_face_is_off_where_the_whole_is_found():
    half = [100, 100, 140, 119]
    assert labels_of([SIGN, half], [SIGN]) == [ON, OFF]
    assert labels_of([half], [SIGN]) == [NEITHER]


def test_a_box_around_two_faces_is_never_on():
    both = [100, 100, 140, 156]
    tall_plaque = [100, 141, 140, 171]
    assert labels_of([SIGN, both]) == [ON, OFF]
    assert labels_of([SIGN, [100, 100, 140, 171]], [SIGN, tall_plaque])[1] == OFF


def test_a_face_inside_another_is_no_second_face():
    board, route = [100, 100, 300, 200], [120, 120, 150, 150]
    assert labels_of([board], [board, route]) == [ON]


def test_faces_too_small_to_teach_make_no_examples_of_what_is_near_them():
    assert labels_of([SIGN, [100, 100, 140, 119], [300, 100, 340, 140]], [SIGN], [False]) == [
        NEITHER,
        NEITHER,
        OFF,
    ]


def view(frame=0, box=SIGN, side="front", visible=1.0):
    return {"frame": frame, "box": box, "side": side, "visible_fraction": visible}


def sign(*views, faces_travel=True):
    return {"faces_travel": faces_travel, "frames": list(views)}


def labels(boxes, *views):
    found, overlap = box_labels(np.array(boxes, np.float32), [({}, one) for one in views])
    return found.tolist(), overlap.tolist()


def test_a_drive_shows_signs_that_face_the_travel_and_panels_from_behind():
    ahead, away = sign(view(3), view(4)), sign(view(4, side="back"), faces_travel=False)
    across = sign(view(3), view(5), faces_travel=False)
    seen, behind = views_by_frame({"signs": [ahead, away, across]})
    assert seen == {k: [(ahead, one)] for k, one in zip((3, 4), ahead["frames"], strict=True)}
    assert behind == {4: [(away, away["frames"][0])]}


def test_boxes_are_labelled_by_the_panel_that_they_overlap_most():
    assert labels([SIGN, [300, 100, 340, 140]], view()) == ([ON, OFF], [1, 0])


def test_where_an_image_shows_no_panel_every_box_is_off():
    assert labels([SIGN, SIGN]) == ([OFF, OFF], [0, 0])


def test_faces_that_are_small_or_hidden_make_no_examples_of_what_is_near_them():
    small = [100, 100, 140, 100 + FACE_PX - 1]
    assert labels([small], view(box=small)) == ([NEITHER], [1])
    assert labels([SIGN], view(visible=0.3)) == ([NEITHER], [1])


def test_a_back_is_an_example_whatever_is_known_of_its_visible_fraction():
    assert labels([SIGN], view(side="back", visible=None)) == ([ON], [1])


def test_signs_that_no_image_may_show_have_no_place():
    placed = {"faces_travel": True, "lateral_m": 4.0, "up_m": 2.0}
    truth = {
        "camera": {"mount": {"height_m": 1.5}},
        "signs": [placed | {"eligible_frames": count} for count in (0, 2)],
    }
    assert sign_positions(truth).tolist() == [[4.0, 0.5]]
    assert sign_positions(truth | {"signs": []}).shape == (0, 2)


def test_a_truth_that_is_none_is_refused(tmp_path):
    path = tmp_path / "x.truth.json"
    path.write_text('{"name": "x"}')
    with pytest.raises(InputError, match="truth of a rendered drive"):
        read_truth(path)
