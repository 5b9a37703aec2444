import numpy as np
import pytest

from wayside.pipeline.learning.networks import NetworkTraining, fit_network
from wayside.stages.classifiers.network import log_probabilities, network_outputs

pytest.importorskip("sklearn", reason="scikit-learn is only needed for learning")

HOW = NetworkTraining(hidden=12, weight_decay=1e-3, learning_rate=5e-3, rounds=30, batch=32)
FEATURES = ("a", "b", "c")


def examples(n=600):
    values = np.random.default_rng(5).normal(size=(n, 3)).astype(np.float32)
    return values, np.ones(n)


def test_numbers_are_told_as_they_are():
    values, weight = examples()
    target = np.column_stack([values[:, 0] + 1, np.abs(values[:, 1])])
    network = fit_network(values, target, weight, HOW, 1, FEATURES)
    assert np.abs(network_outputs(network, values) - target).mean() < 0.1


@pytest.mark.parametrize("count", [2, 3])
def test_the_softmax_of_the_outputs_is_the_chance_of_a_name(count):
    values, weight = examples()
    names = np.array(["low", "mid", "top"])[np.digitize(values[:, 0], [-0.5, 0.5][: count - 1])]
    network = fit_network(values, names, weight, HOW, 1, FEATURES)
    said = np.array(network.classes)[log_probabilities(network, values).argmax(axis=1)]
    assert (said == names).mean() > 0.95


def test_for_true_and_false_the_only_output_is_the_log_odds():
    values, weight = examples(3000)
    probability = 1 / (1 + np.exp(-2 * values[:, 0]))
    true = np.random.default_rng(6).random(3000) < probability
    network = fit_network(values, true, weight, HOW, 1, FEATURES)
    assert network.classes == ("log_odds",)
    said = network_outputs(network, values)
    assert said.shape == (3000, 1)
    assert np.corrcoef(said[:, 0], 2 * values[:, 0])[0, 1] > 0.9
    assert np.abs(1 / (1 + np.exp(-said[:, 0])) - probability).mean() < 0.1


def test_rows_without_weight_are_not_looked_at():
    values, weight = examples()
    target = values[:, :2] * 2
    target[:300] = 50.0
    weight[:300] = 0.0
    network = fit_network(values, target, weight, HOW, 1, FEATURES)
    assert np.abs(network_outputs(network, values[300:]) - target[300:]).mean() < 0.2
    assert network.mean == pytest.approx(values[300:].mean(axis=0), abs=1e-5)
