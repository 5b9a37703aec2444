"""Networks with one hidden layer: fitted by scikit-learn, kept as plain arrays."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import needs
from wayside.schemas.models import NetworkModel


@dataclass(frozen=True, slots=True)
class NetworkTraining:
    """How a network is fitted: hidden units, weight of the squares, step, samples of one step.

    rounds: times that as many samples are gone through as there are; they are drawn by weight, twice as many.
    """

    hidden: int
    weight_decay: float
    learning_rate: float
    rounds: int
    batch: int


def fit_network(
    values: NDArray[np.float32],
    target: NDArray[Any],
    weight: NDArray[np.float64],
    how: NetworkTraining,
    seed: int,
    features: tuple[str, ...],
) -> NetworkModel:
    """Fit to samples drawn by `weight` (n,), so that rare ones are seen as often as common ones.

    Parameters
    ----------
    values : (n, features) float32
    target : (n,) of two or more names, or (n, outputs) of numbers
        What the outputs are taught to tell: the softmax of the outputs is the chance of each name; the only output for
        two names that are False and True is the log odds; numbers are told as they are.
    weight : (n,)
        Rows of weight 0 are not looked at.

    Raises
    ------
    UsageError
        Without scikit-learn, which only the learning needs.
    """
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPClassifier, MLPRegressor
    except ImportError as error:
        raise needs("scikit-learn") from error
    known = values[weight > 0]
    mean, scale = known.mean(axis=0), known.std(axis=0) + 1e-3
    drawn = np.random.default_rng(seed).choice(
        len(weight), 2 * len(weight), p=weight / weight.sum()
    )
    estimator = (MLPRegressor if target.ndim == 2 else MLPClassifier)(
        hidden_layer_sizes=(how.hidden,),
        alpha=how.weight_decay,
        learning_rate_init=how.learning_rate,
        batch_size=min(how.batch, len(drawn)),
        max_iter=max(how.rounds // 2, 1),
        random_state=seed,
    )
    with warnings.catch_warnings():
        # it is stopped early on purpose
        warnings.simplefilter("ignore", ConvergenceWarning)
        estimator.fit((values[drawn] - mean) / scale, target[drawn])
    hidden, output = (np.asarray(w, np.float32) for w in estimator.coefs_)
    hidden_bias, output_bias = (np.asarray(b, np.float32) for b in estimator.intercepts_)
    if target.ndim == 2:
        classes = tuple(str(k) for k in range(target.shape[1]))
    elif target.dtype == np.bool_:
        classes = ("log_odds",)
    else:
        classes = tuple(str(name) for name in estimator.classes_)
    if len(classes) > output.shape[1]:
        # scikit-learn keeps one output for two names
        output = np.hstack([np.zeros_like(output), output])
        output_bias = np.array([0.0, output_bias[0]], np.float32)
    return NetworkModel(
        features,
        classes,
        np.asarray(mean, np.float32),
        np.asarray(scale, np.float32),
        hidden,
        hidden_bias,
        output,
        output_bias,
        "",
    )
