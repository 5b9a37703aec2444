import sys
from importlib.util import find_spec

import numpy as np
import pytest

from wayside.pipeline.learning.cross_validation import platt
from wayside.pipeline.learning.patch_cnn import (
    REAL_FRACTION,
    PatchSamples,
    _exported,
    _network,
    _relative,
    calibrated,
    cnn_log_odds,
    fit_patch_cnn,
    sampling_probabilities,
)
from wayside.pipeline.learning.samples import NEITHER, OFF, ON
from wayside.schemas.errors import InputError, UsageError
from wayside.stages.classifiers.convolution import convolution_output
from wayside.stages.detection.patch_cnn import PATCH_CNN_FEATURES, relative_colors
from wayside.stages.detection.patch_features import SIDE

needs_torch = pytest.mark.skipif(
    find_spec("torch") is None,
    reason="PyTorch is only needed for learning: make .venv/.learn",
)


def samples(count, seed=0, real=False, name="drive"):
    """Half of the boxes show a red square, the others nothing."""
    random = np.random.default_rng(seed)
    patches = random.integers(80, 140, (count, SIDE, SIDE, 3)).astype(np.uint8)
    face = np.arange(count) % 2 == 0
    patches[face, 6:26, 6:26] = (200, 40, 40)
    return PatchSamples(
        name,
        np.arange(count),
        patches,
        random.normal(0, 1, (count, len(PATCH_CNN_FEATURES) - 1)).astype(np.float32),
        np.zeros(count, np.float32),
        np.where(face, ON, OFF).astype(np.int8),
        face.astype(np.float32),
        np.where(face, np.arange(count) // 8, -1).astype(np.int32),
        real,
    )


def test_a_face_of_few_boxes_is_shown_more_often_than_they_are():
    one = samples(8)
    one.face[:] = [0, -1, 1, -1, 1, -1, 1, -1]
    faces, others = sampling_probabilities([one])
    assert faces.sum() == pytest.approx(1)
    assert faces[0] == pytest.approx(np.sqrt(3) * faces[2])
    assert others.tolist() == pytest.approx([0, 0.25] * 4)


def test_boxes_of_real_images_have_their_share_and_what_is_neither_has_none():
    rendered, real = samples(40), samples(8, real=True)
    real.label[1] = NEITHER
    for probability in sampling_probabilities([rendered, real]):
        assert probability[40:].sum() == pytest.approx(REAL_FRACTION)
        assert probability[41] == 0
    alone, _ = sampling_probabilities([rendered])
    assert alone.sum() == pytest.approx(1)


def test_log_odds_of_scores_are_those_they_were_drawn_by():
    random = np.random.default_rng(2)
    scores = random.normal(0, 2, (40000, 2))
    positive = random.random(40000) < 1 / (1 + np.exp(-(scores @ [0.5, 1.5] - 1)))
    slopes, shift = platt(scores, positive)
    assert (*slopes, shift) == pytest.approx((0.5, 1.5, -1), abs=0.07)


def test_without_any_face_nothing_is_learned():
    nothing = samples(8)
    nothing.label[:] = OFF
    with pytest.raises(InputError, match="wanted boxes on faces"):
        sampling_probabilities([nothing])


def test_without_pytorch_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(UsageError, match=r"wanted PyTorch, found none; install it with pip"):
        fit_patch_cnn([samples(8)], -3.0, seed=1)


@needs_torch
def test_what_is_kept_says_what_pytorch_says():
    import torch

    torch.manual_seed(3)
    layers, head = _network(torch, len(PATCH_CNN_FEATURES))
    layers(torch.randn(64, 3, SIDE, SIDE))  # so that its normalisation is not that of nothing
    layers.eval()
    head.eval()
    mean, scale = np.zeros(len(PATCH_CNN_FEATURES)), np.ones(len(PATCH_CNN_FEATURES))
    kept = calibrated(_exported(layers, head, mean, scale, -3.0), 0.3, 2.0, 1.0)
    patches = torch.randn(5, 3, SIDE, SIDE)
    placement = torch.randn(5, len(PATCH_CNN_FEATURES))
    with torch.no_grad():
        joined = torch.cat([layers(patches).permute(0, 2, 3, 1).flatten(1), placement], 1)
        wanted = 2 * head(joined)[:, 0].numpy() + 1
    found = convolution_output(
        kept, np.ascontiguousarray(patches.permute(0, 2, 3, 1)), placement.numpy()
    )
    assert found == pytest.approx(wanted, abs=1e-4)
    assert kept.tree_weight == 0.3


@needs_torch
def test_patches_are_shown_to_pytorch_as_they_are_to_the_classifier():
    import torch

    patches = samples(6).patches
    colors, bright = _relative(torch, torch.from_numpy(patches).permute(0, 3, 1, 2).float())
    wanted, brightness = relative_colors(patches)
    assert np.abs(colors.permute(0, 2, 3, 1).numpy() - wanted).max() < 1e-4
    assert bright.numpy() == pytest.approx(brightness, abs=1e-4)


@needs_torch
@pytest.mark.slow
def test_it_learns_what_a_face_looks_like_and_the_same_each_time():
    training = [samples(2000, 1), samples(200, 2, real=True)]
    model = fit_patch_cnn(training, -3.0, seed=1)
    new = samples(200, 3)
    assert ((cnn_log_odds(model, new) > 0) == (new.label == ON)).mean() > 0.97
    assert (
        cnn_log_odds(fit_patch_cnn(training, -3.0, seed=1), new).tobytes()
        == cnn_log_odds(model, new).tobytes()
    )
