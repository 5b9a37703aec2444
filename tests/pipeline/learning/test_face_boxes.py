import numpy as np
import pytest

from wayside.pipeline.learning.face_boxes import (
    SHAKEN,
    OnFaces,
    learn_face_box,
    on_faces,
    shaken_boxes,
    sides,
)
from wayside.pipeline.learning.samples import Drive, Shown, Views, labelled, read_views
from wayside.schemas.detections import Regions
from wayside.stages.detection.box_regression import SIDES, moved_boxes
from wayside.stages.detection.detector import view_names


def drive():
    shown = Shown(
        np.array([0, 0, 2]),
        np.array([[10, 10, 40, 40], [60, 10, 64, 14], [100, 50, 130, 90]], np.float64),
        np.array([True, False, True]),
        np.ones(3, bool),
    )
    none = Views(
        Regions.empty(),
        np.zeros((0, 0), np.float32),
        *(np.zeros(0, kind) for kind in (np.int32, np.int8, np.float32, np.int32)),
    )
    return Drive("d", 3, (), none, shown, np.ones(3, bool), (), np.zeros((0, 2)), shown)


def test_the_sides_lead_from_the_box_to_the_face():
    box = np.array([[10, 10, 30, 20]], np.float32)
    face = np.array([[5, 12, 40, 20]])
    assert sides(box, face) == pytest.approx(np.array([[-0.25, 0.2, 0.5, 0.0]]))


def test_boxes_are_shaken_round_every_face_that_teaches_and_stay_in_order_of_pictures():
    shaken = shaken_boxes(drive(), 3)
    assert set(shaken.face) == {0, 2}
    assert np.bincount(shaken.face)[[0, 2]].tolist() == [SHAKEN, SHAKEN]
    assert (np.diff(shaken.frame) >= 0).all()
    assert (shaken.overlap > 0.05).all()
    assert len(np.unique(shaken.regions.box, axis=0)) == len(shaken.face)


def test_a_network_learns_what_its_examples_show():
    pytest.importorskip("sklearn", reason="scikit-learn is only needed for learning")
    rng = np.random.default_rng(0)
    names = view_names()
    values = np.zeros((600, len(names)), np.float32)
    column = names.index("inside_mean_brightness")
    values[:, column] = rng.normal(size=600)
    by = np.zeros((600, 4))
    by[:, 2] = 0.3 * values[:, column]
    network = learn_face_box([OnFaces(values, by, np.ones(600))], 1, "made by hand")
    assert network.classes == SIDES
    box = np.tile(np.array([[0, 0, 100, 100]], np.float32), (2, 1))
    probe = np.zeros((2, len(names)), np.float32)
    probe[:, column] = [-1.5, 1.5]
    looked_at = np.ascontiguousarray(probe[:, [names.index(f) for f in network.features]])
    narrow, wide = moved_boxes(network, looked_at, box)
    assert narrow[2] < 85
    assert wide[2] > 115


def test_a_drive_without_faces_gives_no_examples():
    empty = drive()
    shown = Shown(np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros(0, bool), np.ones(3, bool))
    regions = Regions(
        np.array([[0, 0, 9, 9]], np.float32),
        np.array([50], np.int32),
        np.zeros((1, 3), np.float32),
        np.zeros(1, np.uint8),
    )
    views = labelled(regions, np.zeros((1, 0), np.float32), np.zeros(1, np.int64), shown)
    bare = Drive("d", 3, (), empty.views, shown, np.zeros(0, bool), (), np.zeros((0, 2)), shown)
    seen = np.zeros((1, len(view_names())), np.float32)
    found = on_faces(bare, views, seen, lambda _, asked: read_views([], asked), 1)
    assert len(found.values) == len(found.by) == len(found.weight) == 0
