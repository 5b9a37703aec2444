import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wayside.schemas.errors import InputError
from wayside.schemas.model_json import model_from_json, model_to_json
from wayside.schemas.models import NetworkModel
from wayside.stages.classifiers.network import FARTHEST, log_probabilities


def network(seed=0, features=4, hidden=3, classes=3):
    rng = np.random.default_rng(seed)

    def drawn(*shape):
        return rng.normal(size=shape).round(3).astype(np.float32)

    return NetworkModel(
        tuple(f"f{k}" for k in range(features)),
        tuple(f"c{k}" for k in range(classes)),
        drawn(features),
        np.abs(drawn(features)) + np.float32(0.5),
        drawn(features, hidden),
        drawn(hidden),
        drawn(hidden, classes),
        drawn(classes),
        "made by hand",
    )


VALUES = arrays(np.float32, (5, 4), elements=st.floats(-1e4, 1e4, width=32))


@given(VALUES)
def test_the_chances_of_all_classes_sum_to_one(values):
    assert np.exp(log_probabilities(network(), values)).sum(axis=1) == pytest.approx(1, abs=1e-5)


def test_the_chances_are_those_of_the_definition():
    model = network(1)
    x = np.random.default_rng(2).normal(size=(6, 4)).astype(np.float32)
    for row, found in zip(x, log_probabilities(model, x), strict=True):
        z = [(v - m) / s for v, m, s in zip(row, model.mean, model.scale, strict=True)]
        unit = [
            max(0.0, float(np.dot(z, w) + b))
            for w, b in zip(model.hidden.T, model.hidden_bias, strict=True)
        ]
        raw = np.array(
            [np.dot(unit, w) + b for w, b in zip(model.output.T, model.output_bias, strict=True)]
        )
        assert found == pytest.approx(raw - np.log(np.exp(raw).sum()), abs=1e-4)


def test_what_lies_far_outside_says_no_more_than_the_farthest_that_was_seen():
    model = network(3)
    far = (model.mean + FARTHEST * model.scale)[None]
    farther = (model.mean + 100 * FARTHEST * model.scale)[None]
    assert log_probabilities(model, farther) == pytest.approx(
        log_probabilities(model, far), abs=1e-5
    )


def test_no_rows_give_no_rows():
    assert log_probabilities(network(), np.zeros((0, 4), np.float32)).shape == (0, 3)


@pytest.mark.parametrize("values", [np.zeros((2, 3), np.float32), np.zeros((2, 4))])
def test_values_of_another_layout_are_refused(values):
    with pytest.raises(ValueError, match="values"):
        log_probabilities(network(), values)


def test_a_network_written_and_read_is_the_same():
    text = model_to_json(network())
    again = model_from_json(text)
    assert isinstance(again, NetworkModel)
    assert model_to_json(again) == text
    x = np.ones((1, 4), np.float32)
    assert np.array_equal(log_probabilities(again, x), log_probabilities(network(), x))


def test_a_network_of_unequal_parts_is_refused_by_name():
    text = model_to_json(network()).replace('"classes":["c0","c1","c2"]', '"classes":["c0","c1"]')
    with pytest.raises(InputError, match=r"own\.json.*output"):
        model_from_json(text, "own.json")
