"""The patch CNN: a convolutional network on the pixels of a box and its surroundings.

The trees classify every box by a summary of its pixels; the network classifies the pixels of the few boxes that may be
a face by the trees. Their errors differ, so both scores are added.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import ConvolutionModel
from wayside.stages.classifiers import convolution_output
from wayside.stages.detection.feature_vectors import feature_columns
from wayside.stages.detection.patch_features import INNER, SIDE

PLACEMENT = ("log_height", "log_width", "log_aspect", "up", "right", "beside")
"""Features of a box that enter the network beside its pixels, by the names of `box_features`."""

PATCH_CNN_FEATURES = (*PLACEMENT, "brightness")
"""The same, and the logarithm of the mean brightness of the box."""

PATCH_DARK_LEVEL = 16.0
"""Added to a grey value before its logarithm, so that noise of dark pixels is no contrast; part of the input format
of the network, as it was learned with it."""


def patch_log_odds(
    model: ConvolutionModel, patches: NDArray[np.uint8], placement: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Output (n,) of the network for patches (n, 32, 32, 3) with these `placement_features` (n, 6)."""
    colors, brightness = relative_colors(patches)
    features = np.concatenate([placement, brightness[:, None]], axis=1)
    return convolution_output(model, colors, np.ascontiguousarray(features))


def placement_features(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The columns `PLACEMENT` (n, 6) of `box_features` (n, features)."""
    return np.ascontiguousarray(values[:, feature_columns(PLACEMENT)])


def relative_colors(
    patches: NDArray[np.uint8],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colours (n, 32, 32, 3) of patches as the network takes them, and the log brightness (n,) of the box inside.

    Logarithms of brightness, over that of the box, of R/G and of B/G.
    """
    logarithm = np.log(np.arange(256) + PATCH_DARK_LEVEL).astype(np.float32)
    red, green, blue = (logarithm[patches[..., k]] for k in range(3))
    # by the three channels: a sum along an axis of three is slow
    total = patches[..., 0].astype(np.float32) + patches[..., 1] + patches[..., 2]
    bright = np.log(total / np.float32(3) + np.float32(PATCH_DARK_LEVEL))
    edge = (SIDE - INNER) // 2
    middle = bright[:, edge : edge + INNER, edge : edge + INNER].mean(axis=(1, 2))
    colors = np.stack([bright - middle[:, None, None], red - green, blue - green], axis=-1)
    return np.ascontiguousarray(colors), middle
