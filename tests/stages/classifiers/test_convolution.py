import numpy as np
import pytest
from scipy.signal import correlate

from wayside.schemas.errors import InputError
from wayside.schemas.model_json import model_from_json, model_to_json
from wayside.schemas.models import ConvolutionModel
from wayside.stages.classifiers.convolution import TOGETHER, convolution_output


def network(side=8, filters=(5, 4, 3), halved=(True, False, True), seed=0):
    random = np.random.default_rng(seed)

    def some(*shape):
        return random.normal(0, 0.4, shape).astype(np.float32)

    samples = (side // 2 ** sum(halved)) ** 2 * filters[-1]
    return ConvolutionModel(
        ("up", "right"),
        side,
        -5.0,
        0.3,
        4.0,
        tuple(some(3, 3, i, o) for i, o in zip((3, *filters[:-1]), filters, strict=True)),
        tuple(some(o) for o in filters),
        halved,
        some(2),
        np.array([0.5, 2.0], np.float32),
        some(samples + 2, 6),
        some(6),
        some(6),
        some(),
        "made up",
    )


def one_by_one(model, patch, told):
    """The same network by SciPy's correlation, in doubles, a patch and a filter at a time."""
    x = patch.astype(np.float64)
    for weight, bias, halved in zip(model.filters, model.biases, model.pooled, strict=True):
        planes = []
        for o in range(weight.shape[3]):
            channels = [
                correlate(x[..., c], weight[:, :, c, o].astype(np.float64), "same", "direct")
                for c in range(x.shape[2])
            ]
            planes.append(np.maximum(np.sum(channels, axis=0) + bias[o], 0))
        x = np.stack(planes, axis=-1)
        if halved:
            rows, columns, channels = x.shape
            x = x.reshape(rows // 2, 2, columns // 2, 2, channels).max(axis=(1, 3))
    features = np.clip((told - model.mean) / model.scale, -model.feature_limit, model.feature_limit)
    hidden = np.maximum(np.append(x.ravel(), features) @ model.hidden + model.hidden_bias, 0)
    return hidden @ model.output + model.output_bias


@pytest.mark.parametrize("count", [1, 3, TOGETHER, TOGETHER + 1])
def test_each_patch_is_told_what_correlation_after_correlation_says(count):
    random = np.random.default_rng(count)
    model = network()
    patches = random.normal(0, 1, (count, 8, 8, 3)).astype(np.float32)
    told = random.normal(0, 3, (count, 2)).astype(np.float32)
    wanted = [one_by_one(model, p, t) for p, t in zip(patches, told, strict=True)]
    np.testing.assert_allclose(
        convolution_output(model, patches, told), wanted, rtol=1e-4, atol=1e-4
    )


def test_no_patches_give_no_odds():
    nothing = convolution_output(
        network(), np.zeros((0, 8, 8, 3), np.float32), np.zeros((0, 2), np.float32)
    )
    assert nothing.shape == (0,)
    assert nothing.dtype == np.float32


@pytest.mark.parametrize(
    ("patches", "told"),
    [
        ((4, 6, 6, 3), (4, 2)),
        ((4, 8, 8, 2), (4, 2)),
        ((4, 8, 8, 3), (3, 2)),
        ((4, 8, 8, 3), (4, 3)),
    ],
)
def test_patches_or_features_of_another_size_are_refused(patches, told):
    with pytest.raises(ValueError, match="wanted"):
        convolution_output(network(), np.zeros(patches, np.float32), np.zeros(told, np.float32))


def test_written_and_read_it_says_the_same():
    model = network()
    text = model_to_json(model)
    read = model_from_json(text)
    assert isinstance(read, ConvolutionModel)
    assert model_to_json(read) == text
    patches = np.random.default_rng(1).normal(0, 1, (4, 8, 8, 3)).astype(np.float32)
    told = np.zeros((4, 2), np.float32)
    np.testing.assert_allclose(
        convolution_output(read, patches, told),
        convolution_output(model, patches, told),
        rtol=1e-3,
        atol=1e-3,
    )


@pytest.mark.parametrize(
    ("found", "broken"),
    [
        ('"side":8', '"side":6'),
        ('"halved":[true,false,true]', '"halved":[true,false]'),
        ('"features":["up","right"]', '"features":["up"]'),
    ],
)
def test_a_damaged_network_is_refused(found, broken):
    text = model_to_json(network())
    assert found in text
    with pytest.raises(InputError, match="wanted a wayside model file"):
        model_from_json(text.replace(found, broken))
