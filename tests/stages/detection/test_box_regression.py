import numpy as np
import pytest

from wayside.schemas.detections import SOURCES, Regions
from wayside.schemas.frame import Camera
from wayside.schemas.models import NetworkModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection.box_regression import SIDES, regressed_regions
from wayside.stages.detection.feature_vectors import box_feature_names

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
BOX = np.array([[100, 80, 120, 100], [10, 20, 50, 40]], np.float32)
VALUES = np.zeros((2, len(box_feature_names())), np.float32)
SETTINGS = CandidateSettings()


def predicting(*by):
    """A network that predicts the same offsets for every box."""
    return NetworkModel(
        ("log_height",),
        SIDES,
        np.zeros(1, np.float32),
        np.ones(1, np.float32),
        np.zeros((1, 2), np.float32),
        np.zeros(2, np.float32),
        np.zeros((2, 4), np.float32),
        np.array(by, np.float32),
        "made by hand",
    )


def moved_boxes(network, box, camera=None):
    n = len(box)
    regions = Regions(box, np.full(n, 50), np.full((n, 3), 90, np.float32), np.zeros(n, np.uint8))
    moved = regressed_regions(network, VALUES[:n], regions, SETTINGS, camera)
    assert (moved.source == SOURCES.index("moved")).all()
    return moved.box


def test_a_box_is_moved_by_fractions_of_its_size():
    moved = moved_boxes(predicting(-0.5, 0.1, 0.25, 1.0), BOX, CAMERA)
    assert moved == pytest.approx(np.array([[90, 82, 125, 120], [-0, 22, 60, 60]]))
    assert moved.dtype == np.float32


def test_a_box_ends_at_the_border_of_the_image_where_one_is_known():
    out = predicting(-1.0, -1.2, 0.0, 0.0)
    assert moved_boxes(out, BOX, CAMERA)[1].tolist() == [0, 0, 50, 40]
    assert moved_boxes(out, BOX)[1].tolist() == pytest.approx([-30, -4, 50, 40])


def test_a_box_that_no_face_can_have_is_not_taken():
    turned = predicting(0.9, 0.0, -0.9, 0.0)
    flat = predicting(0.0, 0.45, 0.0, -0.45)
    thin = predicting(0.45, -1.0, -0.45, 1.0)
    for network in (turned, flat, thin):
        assert np.array_equal(moved_boxes(network, BOX, CAMERA), BOX)
    width, height = (BOX[0, 2:] - BOX[0, :2]).tolist()
    assert height * 0.1 < SETTINGS.shortest_px
    assert width * 0.1 / (3 * height) < SETTINGS.narrowest_aspect


def test_larger_offsets_than_learned_are_cut_off():
    moved = moved_boxes(predicting(-9.0, 0.0, 0.0, 0.0), BOX[:1], CAMERA)
    assert moved[0, 0] == 100 - SETTINGS.largest_offset * 20
