import numpy as np
import pytest

from wayside.pipeline.learning.box_regression import (
    JITTERED,
    BoxRegressionSamples,
    jittered_boxes,
    learn_box_regressor,
    regression_samples,
    side_offsets,
)
from wayside.pipeline.learning.samples import (
    CandidateSamples,
    TrainingDrive,
    TrueFaces,
    labelled,
    read_box_features,
)
from wayside.schemas.detections import Regions
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection import SIDES, box_feature_names, regressed_regions


def drive():
    true_faces = TrueFaces(
        np.array([0, 0, 2]),
        np.array([[10, 10, 40, 40], [60, 10, 64, 14], [100, 50, 130, 90]], np.float64),
        np.array([True, False, True]),
        np.ones(3, bool),
    )
    none = CandidateSamples(
        Regions.empty(),
        *(np.zeros(0, kind) for kind in (np.int32, np.int8, np.float32, np.int32)),
    )
    return TrainingDrive(
        "d", 3, (), none, true_faces, np.ones(3, bool), (), np.zeros((0, 2)), true_faces
    )


def test_the_sides_lead_from_the_box_to_the_face():
    box = np.array([[10, 10, 30, 20]], np.float32)
    face = np.array([[5, 12, 40, 20]])
    assert side_offsets(box, face, 1.0) == pytest.approx(np.array([[-0.25, 0.2, 0.5, 0.0]]))


def test_boxes_are_jittered_around_every_example_face_in_order_of_images():
    jittered = jittered_boxes(drive(), 3, 8)
    assert set(jittered.face) == {0, 2}
    assert np.bincount(jittered.face)[[0, 2]].tolist() == [JITTERED, JITTERED]
    assert (np.diff(jittered.frame) >= 0).all()
    assert (jittered.overlap > 0.05).all()
    assert len(np.unique(jittered.regions.box, axis=0)) == len(jittered.face)


def test_a_network_learns_what_its_examples_show():
    pytest.importorskip("sklearn", reason="scikit-learn is only needed for learning")
    rng = np.random.default_rng(0)
    names = box_feature_names()
    values = np.zeros((600, len(names)), np.float32)
    column = names.index("inside_mean_brightness")
    values[:, column] = rng.normal(size=600)
    offset = np.zeros((600, 4))
    offset[:, 2] = 0.3 * values[:, column]
    network = learn_box_regressor(
        [BoxRegressionSamples(values, offset, np.ones(600))], 1, "made by hand"
    )
    assert network.classes == SIDES
    box = np.tile(np.array([[0, 0, 100, 100]], np.float32), (2, 1))
    regions = Regions(box, np.full(2, 50), np.full((2, 3), 90, np.float32), np.zeros(2, np.uint8))
    probe = np.zeros((2, len(names)), np.float32)
    probe[:, column] = [-1.5, 1.5]
    narrow, wide = regressed_regions(network, probe, regions, CandidateSettings()).box
    assert narrow[2] < 85
    assert wide[2] > 115


def test_a_drive_without_faces_gives_no_examples():
    empty = drive()
    true_faces = TrueFaces(
        np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros(0, bool), np.ones(3, bool)
    )
    regions = Regions(
        np.array([[0, 0, 9, 9]], np.float32),
        np.array([50], np.int32),
        np.zeros((1, 3), np.float32),
        np.zeros(1, np.uint8),
    )
    candidates = labelled(regions, np.zeros(1, np.int64), true_faces)
    bare = TrainingDrive(
        "d",
        3,
        (),
        empty.candidates,
        true_faces,
        np.zeros(0, bool),
        (),
        np.zeros((0, 2)),
        true_faces,
    )
    seen = np.zeros((1, len(box_feature_names())), np.float32)
    found = regression_samples(
        bare,
        candidates,
        seen,
        lambda _, asked: read_box_features([], asked),
        1,
        CandidateSettings(),
    )
    assert len(found.values) == len(found.offset) == len(found.weight) == 0
