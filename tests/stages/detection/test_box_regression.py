import numpy as np
import pytest

from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.models import NetworkModel
from wayside.stages.detection.box_regression import FARTHEST, SIDES, check_box_network, moved_boxes
from wayside.stages.detection.proposals import NARROWEST, SHORTEST_PX, WIDEST

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
BOX = np.array([[100, 80, 120, 100], [10, 20, 50, 40]], np.float32)
VALUES = np.zeros((2, 1), np.float32)


def telling(*by, classes=SIDES):
    """A network that tells the same sides of whatever it sees."""
    return NetworkModel(
        ("what",),
        classes,
        np.zeros(1, np.float32),
        np.ones(1, np.float32),
        np.zeros((1, 2), np.float32),
        np.zeros(2, np.float32),
        np.zeros((2, 4), np.float32),
        np.array(by, np.float32),
        "made by hand",
    )


def test_a_box_is_moved_by_shares_of_its_size():
    moved = moved_boxes(telling(-0.5, 0.1, 0.25, 1.0), VALUES, BOX, CAMERA)
    assert moved == pytest.approx(np.array([[90, 82, 125, 120], [-0, 22, 60, 60]]))
    assert moved.dtype == np.float32


def test_a_box_ends_at_the_border_of_the_picture_where_one_is_known():
    out = telling(-1.0, -1.2, 0.0, 0.0)
    assert moved_boxes(out, VALUES, BOX, CAMERA)[1].tolist() == [0, 0, 50, 40]
    assert moved_boxes(out, VALUES, BOX)[1].tolist() == pytest.approx([-30, -4, 50, 40])


def test_what_would_be_no_box_of_a_face_stays():
    turned = telling(0.9, 0.0, -0.9, 0.0)
    flat = telling(0.0, 0.45, 0.0, -0.45)
    thin = telling(0.45, -1.0, -0.45, 1.0)
    for network in (turned, flat, thin):
        assert np.array_equal(moved_boxes(network, VALUES, BOX, CAMERA), BOX)
    width, height = (BOX[0, 2:] - BOX[0, :2]).tolist()
    assert height * 0.1 < SHORTEST_PX
    assert width * 0.1 / (3 * height) < NARROWEST < WIDEST


def test_sides_far_away_are_not_believed():
    moved = moved_boxes(telling(-9.0, 0.0, 0.0, 0.0), VALUES, BOX[:1], CAMERA)
    assert moved[0, 0] == 100 - FARTHEST * 20


def test_a_network_for_something_else_is_refused():
    check_box_network(telling(0, 0, 0, 0), ("what",))
    with pytest.raises(InputError, match="box network"):
        check_box_network(telling(0, 0, 0, 0), ("other",))
    with pytest.raises(InputError, match=r"box network.*found a, b, c, d"):
        check_box_network(telling(0, 0, 0, 0, classes=("a", "b", "c", "d")), ("what",))
