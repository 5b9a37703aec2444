"""What the truth of a drive says: what its images show, and the labels of boxes and landmarks by it."""

import numpy as np
import pytest

from training.truth import KnownPanels, View, box_labels, read_truth, sign_positions, views_by_frame
from wayside.pipeline.learning.labelled import FACE_PX, NEITHER, OFF, ON
from wayside.schemas.errors import InputError
from wayside.schemas.landmarks import Observation

SIGN, PLAQUE, AWAY = [100, 100, 140, 140], [105, 141, 135, 156], [400, 100, 440, 140]
HALF, LOOSE, BOTH = [100, 100, 140, 119], [90, 100, 145, 150], [100, 100, 140, 156]
TALL_PLAQUE, BOARD, ROUTE = [100, 141, 140, 171], [100, 100, 300, 200], [120, 120, 150, 150]


@pytest.mark.parametrize(
    ("boxes", "faces", "wanted"),
    [
        ([SIGN, [101, 101, 139, 140], AWAY], [SIGN, PLAQUE], [ON, ON, OFF]),
        ([SIGN, LOOSE], [SIGN], [ON, NEITHER]),  # no example beside a tight box
        ([LOOSE], [SIGN], [ON]),
        ([SIGN, HALF], [SIGN], [ON, OFF]),  # off where the whole is found
        ([HALF], [SIGN], [NEITHER]),
        ([SIGN, BOTH], [SIGN, PLAQUE], [ON, OFF]),  # around two faces
        ([SIGN, [100, 100, 140, 171]], [SIGN, TALL_PLAQUE], [ON, OFF]),
        ([BOARD], [BOARD, ROUTE], [ON]),  # a face inside another is no second one
        ([SIGN, SIGN], [], [OFF, OFF]),
    ],
)
def test_boxes_are_labelled_by_the_panel_that_they_overlap_most(boxes, faces, wanted):
    label, overlap = box_labels(np.array(boxes, float), [View({}, False, box) for box in faces])
    assert label.tolist() == wanted
    assert (overlap > 0).tolist() == [
        one in (SIGN, *boxes) and one != AWAY and bool(faces) for one in boxes
    ]


def view(box, side="front", visible=1.0, frame=3):
    return {"frame": frame, "box": box, "side": side, "visible_fraction": visible}


def test_what_is_small_or_hidden_makes_no_examples_of_what_is_near_it_and_a_back_is_always_one():
    shown = [SIGN, [0, 0, 40, FACE_PX - 1], [200, 0, 240, 40], [300, 0, 340, 40]]
    hidden = [view(shown[2], visible=0.3), view(shown[3], "back", None)]
    sign = {"frames": [view(shown[0]), view(shown[1]), *hidden, view(SIGN, frame=5)]}
    views = views_by_frame({"signs": [sign]})
    assert [(frame, len(seen)) for frame, seen in views.items()] == [(3, 4), (5, 1)]
    assert [one.back for one in views[3]] == [False, False, False, True]
    assert box_labels(np.array(shown, float), views[3])[0].tolist() == [ON, NEITHER, NEITHER, ON]


def test_signs_that_no_image_may_show_have_no_place():
    placed = {"faces_travel": True, "lateral_m": 4.0, "up_m": 2.0}
    signs = [placed | {"eligible_frames": count} for count in (0, 2)]
    truth = {"camera": {"mount": {"height_m": 1.5}}, "signs": signs}
    assert sign_positions(truth).tolist() == [[4.0, 0.5]]
    assert sign_positions(truth | {"signs": []}).shape == (0, 2)


def test_a_truth_that_is_none_is_refused(tmp_path):
    (tmp_path / "x.truth.json").write_text('{"name": "x"}')
    with pytest.raises(InputError, match="truth of a rendered drive"):
        read_truth(tmp_path / "x.mcap")


class SeenAt:
    """A landmark as far as labels need it."""

    def __init__(self, *boxes, back=False, position=(1.0, -0.5, 20.0)):
        self.back = back
        self.best_frame = len(boxes) - 1
        self.position = np.array(position)
        self.views = tuple(Observation(i, 0, 0.0, 0.0, box, 0.0) for i, box in enumerate(boxes))


def known(side="front", faces_travel=True):
    sign = {"id": 7, "faces_travel": faces_travel, "centre": [1.0, -0.5, 28.0]}
    sign["frames"] = [view(SIGN, side, frame=i) for i in range(3)]
    camera = {"quaternion": [0.0, 0.0, 0.0, 1.0]}
    frames = [camera | {"index": i, "position": [0.0, 0.0, 4.0 * i]} for i in range(3)]
    return KnownPanels.of({"signs": [sign], "frames": frames})


@pytest.mark.parametrize(
    ("landmark", "panels", "wanted"),
    [
        (SeenAt(SIGN, SIGN, SIGN), {}, ON),
        (SeenAt(AWAY, AWAY, AWAY), {}, OFF),
        (SeenAt(SIGN, SIGN, SIGN, position=(2.0, -1.0, 40.0)), {}, OFF),  # a wrong depth
        (SeenAt(SIGN, AWAY, AWAY), {}, NEITHER),
        (SeenAt(*[[100, 100, 140, 114]] * 3), {}, NEITHER),
        (SeenAt(*[[100, 100, 140, 114]] * 3, position=(9.0, -0.5, 20.0)), {}, OFF),
        (SeenAt(SIGN, SIGN, SIGN), {"side": "back"}, OFF),
        (SeenAt(SIGN, SIGN, SIGN), {"faces_travel": False}, OFF),
        (SeenAt(SIGN, SIGN, SIGN, back=True), {"side": "back", "faces_travel": False}, ON),
        (SeenAt(SIGN, SIGN, SIGN, back=True), {}, OFF),
        (SeenAt(AWAY, AWAY, AWAY, back=True), {"side": "back"}, OFF),
    ],
)
def test_a_landmark_is_a_panel_that_it_lies_on_from_its_side_and_where_it_stands(
    landmark, panels, wanted
):
    assert known(**panels).label(landmark) == wanted


def test_by_boxes_alone_it_does_not_matter_where_a_landmark_was_measured():
    assert known().label_in_images(SeenAt(SIGN, SIGN, SIGN, position=(2.0, -1.0, 40.0))) == ON


def test_hand_made_boxes_decide_in_the_images_that_have_them():
    sign = {"id": "A", "facing": "front", "boxes": [{"i": 1, "box": SIGN}]}
    panels = KnownPanels.of_labels({"signs": [sign]}, {"2": {"signs": [[*AWAY, None, None]]}})
    half = [100, 100, 140, 114]
    seen = [(AWAY, SIGN, SIGN), (SIGN, half, SIGN), (SIGN, AWAY, AWAY), (SIGN, AWAY, SIGN)]
    assert [panels.label(SeenAt(*boxes)) for boxes in seen] == [ON, NEITHER, ON, OFF]
    group = KnownPanels.of_labels({"signs": [sign | {"group": True}]}, {})
    assert group.label(SeenAt(SIGN, SIGN, SIGN)) == NEITHER
