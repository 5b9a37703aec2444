"""The face classifier: what teaches it, that it learns it, is as sure as it is right, and says the same as a file."""

from pathlib import Path

import numpy as np
import pytest

from training import face_classes
from wayside.pipeline.models.model_files import onnx_metadata
from wayside.schemas.sign_catalogue import CATALOGUE
from wayside.stages.sign_codes import OTHER_FACE, FaceClassifier

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"
CATALOGUED = {face for signs in CATALOGUE.values() for one in signs for face in one.faces}


def drawing(kind, color="white", shape="circle", **more):
    return {"kind": kind, "color": color, "shape": shape, **more}


@pytest.mark.parametrize(
    ("entry", "wanted"),
    [
        (drawing("stop", "red", "octagon", code="R1-1", props={}), "stop"),
        (drawing("limit", shape="rectangle", code="R2-1", props={"speed": 45}), "R2-1 45"),
        (drawing("maximum speed limit 50"), "C14 50"),
        (drawing("maximum speed limit 50", shape="rectangle"), "R2-1 50"),
        (drawing("curve left", shape="triangle"), "A1a"),
        (drawing("curve left", "yellow", "diamond"), None),
        (drawing("camel crossing", "yellow", "diamond"), OTHER_FACE),
        (drawing("no horn"), OTHER_FACE),
    ],
)
def test_a_drawing_teaches_its_code_or_nothing_where_it_may_be_another(entry, wanted):
    assert face_classes.class_of_drawing(entry) == wanted


def test_every_class_that_is_taught_is_in_the_catalogue():
    assert {*face_classes.GTSRB, *face_classes.DRAWN.values()} <= CATALOGUED
    assert len(face_classes.GTSRB) == 43


def test_no_track_both_teaches_and_measures():
    parts = [*face_classes.TAUGHT, *face_classes.VALIDATED, *face_classes.TESTED]
    assert sorted(parts) == list(range(9))


@pytest.mark.skipif(not (REAL / "faces").is_dir(), reason="drawings of others are not here")
def test_every_face_of_the_catalogue_has_a_drawing():
    drawn = {one.name for one in face_classes.drawings(REAL)}
    without = {"A19", "C14 60", "C14 70"}  # crops alone, or on a yellow ground
    assert CATALOGUED - drawn - without == set()
    assert drawn <= CATALOGUED | {OTHER_FACE}


NAMES = np.array(["R1-1", "D9", OTHER_FACE])


@pytest.fixture
def module(torch):
    from training import face_codes

    return face_codes


@pytest.fixture
def untrained(torch, module):
    torch.manual_seed(4)
    return module.FaceNetwork(NAMES)


def examples(count, seed=0):
    """Patches with a red square, with a blue bar, or with nothing, and their classes."""
    random = np.random.default_rng(seed)
    names = NAMES[np.arange(count) % 3]
    patches = random.integers(60, 120, (count, 32, 32, 3)).astype(np.uint8)
    patches[names == "R1-1", 8:24, 8:24] = (200, 30, 40)
    patches[names == "D9", :, 12:20] = (20, 60, 200)
    return patches, names


def test_the_classifier_learns_what_it_is_shown(module):
    network = module.fit(*examples(600), seed=1)
    assert network.classes == ("D9", "R1-1", OTHER_FACE)
    patches, names = examples(60, seed=1)
    best = network.log_probabilities(patches).argmax(axis=1)
    assert (np.array(network.classes)[best] == names).mean() > 0.95


def test_it_learns_to_name_in_grey_what_it_is_shown_in_colour(module, monkeypatch):
    patches, names = examples(90, seed=1)
    grey = module.in_grey(patches, np.random.default_rng(3))
    assert (grey == grey[..., :1]).all()

    def right():
        network = module.fit(*examples(600), seed=1)
        best = network.log_probabilities(grey).argmax(axis=1)
        return (np.array(network.classes)[best] == names).mean()

    in_both = right()
    monkeypatch.setattr(module, "GREY", 0)
    assert in_both > right() + 0.2


def test_a_classifier_that_is_wrong_becomes_less_sure_and_names_the_same(torch, module, untrained):
    with torch.no_grad():
        untrained.out.weight.mul_(50)
    patches, names = examples(60)
    wrong = np.roll(names, 1)
    before = untrained.log_probabilities(patches)
    module.at_temperature(untrained, patches, wrong)
    after = untrained.log_probabilities(patches)
    np.testing.assert_array_equal(after.argmax(axis=1), before.argmax(axis=1))
    assert after.max(axis=1).mean() < before.max(axis=1).mean()
    np.testing.assert_allclose(np.exp(after).sum(axis=1), 1)


def test_the_file_says_the_same_and_names_classes_and_provenance(module, untrained, tmp_path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    path = tmp_path / "face_code.onnx"
    with pytest.warns():
        module.export(untrained, path, "made-up drawings")
    found = FaceClassifier(str(path))
    assert found.classes == tuple(NAMES)
    patches, _ = examples(7)
    np.testing.assert_allclose(
        found.log_probabilities(patches), untrained.log_probabilities(patches), atol=1e-4
    )
    assert onnx_metadata(path.read_bytes())["provenance"] == "made-up drawings"
