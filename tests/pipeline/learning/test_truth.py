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

SIGN, PLAQUE, FAR = [100, 100, 140, 140], [105, 141, 135, 156], [300, 100, 340, 140]
SMALL = [100, 100, 140, 100 + FACE_PX - 1]
LOOSE, HALF = [90, 100, 145, 150], [100, 100, 140, 119]
BOARD, ROUTE = [100, 100, 300, 200], [120, 120, 150, 150]


@pytest.mark.parametrize(
    ("boxes", "faces", "expected"),
    [
        pytest.param([SIGN, [101, 101, 139, 140], FAR], [SIGN], [ON, ON, OFF], id="tight and far"),
        pytest.param([SIGN, LOOSE], [SIGN], [ON, NEITHER], id="a loose one beside a tight one"),
        pytest.param([LOOSE], [SIGN], [ON], id="a loose one alone"),
        pytest.param([SIGN, HALF], [SIGN], [ON, OFF], id="a part where the whole is found"),
        pytest.param([HALF], [SIGN], [NEITHER], id="a part alone"),
        pytest.param([SIGN, [100, 100, 140, 156]], [SIGN, PLAQUE], [ON, OFF], id="around two"),
        pytest.param(
            [SIGN, [100, 100, 140, 171]],
            [SIGN, [100, 141, 140, 171]],
            [ON, OFF],
            id="around two as wide as each",
        ),
        pytest.param([BOARD], [BOARD, ROUTE], [ON], id="a face inside of another"),
    ],
)
def test_what_a_box_around_faces_is_an_example_of(boxes, faces, expected):
    examples = np.ones(len(faces), bool)
    found = face_labels(np.array(boxes, np.float32), np.array(faces, np.float64), examples)
    assert found.tolist() == expected


def test_near_a_face_too_small_to_teach_nothing_is_an_example():
    boxes = np.array([SIGN, HALF, FAR], np.float32)
    found = face_labels(boxes, np.array([SIGN], np.float64), np.array([False]))
    assert found.tolist() == [NEITHER, NEITHER, OFF]


def view(frame=0, box=SIGN, side="front", visible=1.0):
    return {"frame": frame, "box": box, "side": side, "visible_fraction": visible}


def sign(*views, faces_travel=True):
    return {"faces_travel": faces_travel, "frames": list(views)}


def test_a_drive_shows_signs_that_face_the_travel_and_panels_from_behind():
    ahead, away = sign(view(3), view(4)), sign(view(4, side="back"), faces_travel=False)
    across = sign(view(3), view(5), faces_travel=False)
    seen, behind = views_by_frame({"signs": [ahead, away, across]})
    assert seen == {k: [(ahead, one)] for k, one in zip((3, 4), ahead["frames"], strict=True)}
    assert behind == {4: [(away, away["frames"][0])]}


@pytest.mark.parametrize(
    ("boxes", "views", "labels", "overlap"),
    [
        pytest.param([SIGN, FAR], [view()], [ON, OFF], [1, 0], id="of the panel beneath"),
        pytest.param([SIGN, SIGN], [], [OFF, OFF], [0, 0], id="no panel"),
        pytest.param([SMALL], [view(box=SMALL)], [NEITHER], [1], id="small"),
        pytest.param([SIGN], [view(visible=0.3)], [NEITHER], [1], id="hidden"),
        pytest.param([SIGN], [view(side="back", visible=None)], [ON], [1], id="a back"),
    ],
)
def test_boxes_are_labelled_by_the_panels_that_an_image_shows(boxes, views, labels, overlap):
    found, shared = box_labels(np.array(boxes, np.float32), [({}, one) for one in views])
    assert (found.tolist(), shared.tolist()) == (labels, overlap)


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
