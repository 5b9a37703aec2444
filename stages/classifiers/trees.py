"""Boosted trees (Friedman 2001) evaluated on many rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import TreeModel
from wayside.stages.classifiers.network import network_outputs
from wayside.stages.kernels import compiled, require_array


def log_odds(model: TreeModel, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sum over the trees plus bias for each row of `values` (n, features of the model): (n,) log odds.

    The output of the network of the model, where it has one, is added.

    Raises
    ------
    ValueError
        If the number of columns is not the model's.
    """
    values = np.ascontiguousarray(values, np.float32)
    require_array(values, "values", np.float32, (None, len(model.features)))
    result = np.empty(len(values), np.float32)
    _sum_trees(
        values,
        np.ascontiguousarray(model.feature, np.int32),
        np.ascontiguousarray(model.split, np.float32),
        np.ascontiguousarray(model.left, np.int32),
        np.ascontiguousarray(model.right, np.int32),
        np.ascontiguousarray(model.value, np.float32),
        model.bias,
        result,
    )
    if model.network is not None:
        result += network_outputs(model.network, values)[:, 0]
    return result


@compiled
def _sum_trees(
    values: Any,
    feature: Any,
    split: Any,
    left: Any,
    right: Any,
    value: Any,
    bias: Any,
    result: Any,
) -> None:
    nodes = feature.shape[1]
    for i in range(values.shape[0]):
        total = bias
        for t in range(feature.shape[0]):
            k = 0
            for _ in range(nodes):
                if left[t, k] < 0:
                    break
                v = values[i, feature[t, k]]
                # Written so that nan goes left.
                k = right[t, k] if v > split[t, k] else left[t, k]
            total += value[t, k]
        result[i] = total
