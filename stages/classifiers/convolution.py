"""A small convolutional network evaluated on many patches (LeCun et al. 1998)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import ConvolutionModel
from wayside.stages.kernels import require_array

TOGETHER, FILTERED = 32, 8
"""Patches evaluated at once by the layers behind the filters, and by the filters: these hold nine times as many
samples, which are to stay in the processor's cache."""


def convolution_output(
    model: ConvolutionModel, patches: NDArray[np.float32], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Output of the network for each patch, shape (n,), or (n, classes) of a network with classes.

    Parameters
    ----------
    model
        Each layer of filters (3 x 3, borders padded with zeros) is followed by max(0, x), and by 2 x 2 maximum pooling
        where `pooled`; then one hidden layer over all samples and the features, and one output.
    patches
        (n, side, side, channels) float32.
    values
        (n, features) float32, joined to the samples before the hidden layer.

    Raises
    ------
    ValueError
        If patches or values are of another type or size than the model's.
    """
    side, channels = model.side, model.filters[0].shape[2]
    require_array(patches, "patches", np.float32, (None, side, side, channels))
    require_array(values, "values", np.float32, (len(patches), len(model.features)))
    parts = [np.zeros((0, *model.output_bias.shape), np.float32)]
    for first in range(0, len(patches), TOGETHER):
        rows = slice(first, first + TOGETHER)
        parts.append(_evaluate(model, patches[rows], values[rows]))
    return np.concatenate(parts)


def _evaluate(
    model: ConvolutionModel, samples: NDArray[np.float32], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    found = [_filters(model, samples[k : k + FILTERED]) for k in range(0, len(samples), FILTERED)]
    scaled = np.clip((values - model.mean) / model.scale, -model.feature_limit, model.feature_limit)
    joined = np.concatenate([np.concatenate(found), scaled], axis=1)
    hidden = np.maximum(joined @ model.hidden + model.hidden_bias, np.float32(0))
    return np.asarray(hidden @ model.output + model.output_bias, np.float32)


def _filters(model: ConvolutionModel, samples: NDArray[np.float32]) -> NDArray[np.float32]:
    """What all layers of filters make of some patches, one row each."""
    for weight, bias, halved in zip(model.filters, model.biases, model.pooled, strict=True):
        samples = filtered(samples, weight)
        # the largest of four sums is the sum of the largest: a quarter of the additions, the same bits
        samples = max_pool(samples) if halved else samples
        samples += bias
        np.maximum(samples, np.float32(0), out=samples)
    return samples.reshape(len(samples), -1)


def filtered(samples: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Correlate samples (n, rows, columns, in) with filters (3, 3, in, out), zeros beyond the border."""
    n, rows, columns, channels = samples.shape
    padded = np.zeros((n, rows + 2, columns + 2, channels), np.float32)
    padded[:, 1:-1, 1:-1] = samples
    # three neighbours of a row lie side by side in memory: they are copied at once
    step, row, column, value = padded.strides
    beside = np.lib.stride_tricks.as_strided(
        padded, (n, rows, columns, 3, 3 * channels), (step, row, column, row, value)
    ).reshape(n * rows * columns, 9 * channels)
    found = beside @ weight.reshape(9 * channels, -1)
    return np.asarray(found.reshape(n, rows, columns, -1), np.float32)


def max_pool(samples: NDArray[np.float32]) -> NDArray[np.float32]:
    """The largest of each 2 x 2 samples: (n, rows / 2, columns / 2, channels)."""
    across = np.maximum(samples[:, :, 0::2], samples[:, :, 1::2])
    return np.maximum(across[:, 0::2], across[:, 1::2])
