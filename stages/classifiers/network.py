"""A network with one hidden layer evaluated on many rows (Rumelhart, Hinton and Williams 1986)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import NetworkModel
from wayside.stages.kernels import require_array

FARTHEST = 6.0
"""Standard deviations from the mean beyond which a feature says no more: the network has not seen such."""


def log_probabilities(model: NetworkModel, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithm of the chance of each class for each row of `values` (n, features): (n, classes).

    Raises
    ------
    ValueError
        If the values are of another type or number of columns than the model's.
    """
    raw = network_outputs(model, values)
    raw -= raw.max(axis=1, keepdims=True, initial=-np.inf)
    return np.asarray(raw - np.log(np.exp(raw).sum(axis=1, keepdims=True)), np.float32)


def network_outputs(model: NetworkModel, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """What the network says of each row of `values` (n, features), before it is made a chance: (n, classes).

    Raises
    ------
    ValueError
        If the values are of another type or number of columns than the model's.
    """
    require_array(values, "values", np.float32, (None, len(model.features)))
    scaled = np.clip((values - model.mean) / model.scale, -FARTHEST, FARTHEST)
    hidden = np.maximum(scaled @ model.hidden + model.hidden_bias, np.float32(0))
    return np.asarray(hidden @ model.output + model.output_bias, np.float32)
