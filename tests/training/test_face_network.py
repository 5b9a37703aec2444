"""The face classifier learns what it is shown, is as sure as it is right, and says the same as a file."""

import numpy as np
import pytest

from wayside.pipeline.models.model_files import onnx_metadata
from wayside.stages.sign_codes import OTHER_FACE, FaceClassifier

NAMES = np.array(["R1-1", "D9", OTHER_FACE])


@pytest.fixture
def module(torch):
    from training import face_network

    return face_network


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


@pytest.mark.slow
def test_the_classifier_learns_what_it_is_shown(module):
    network = module.fit(*examples(600), seed=1)
    assert network.classes == ("D9", "R1-1", OTHER_FACE)
    patches, names = examples(60, seed=1)
    best = network.log_probabilities(patches).argmax(axis=1)
    assert (np.array(network.classes)[best] == names).mean() > 0.95


@pytest.mark.slow
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
