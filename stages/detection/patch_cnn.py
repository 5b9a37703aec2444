"""The closer look at a box: a convolutional network on the very pixels of it and its surroundings.

The trees see a summary of what a box shows, quickly; of the few boxes that may be a face by it, the network sees all.
They err on different boxes, so both are heard.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import InputError
from wayside.schemas.models import ConvolutionModel
from wayside.stages.classifiers import convolved
from wayside.stages.detection.patch_features import INNER, SIDE, drawn_patches

PLACES = ("log_height", "log_width", "log_aspect", "up", "right", "beside")
"""What the network is told of a box, by the names of `view_features`."""

FEATURES = (*PLACES, "brightness")
"""The same, and the logarithm of the mean brightness of the box."""

DARK = 16.0
"""What is added to a grey value before its logarithm: the noise of dark pixels is no contrast."""


def check_closer(model: ConvolutionModel | None) -> None:
    """Refuse a network that looks at something else than it is shown; raises InputError."""
    if model is not None and (model.features != FEATURES or model.side != SIDE):
        raise InputError(
            f"closer look: wanted a patch of {SIDE} and the features {', '.join(FEATURES)}, found "
            f"{model.side} and {', '.join(model.features)}; learn it again"
        )


def closer_odds(
    model: ConvolutionModel,
    levels: tuple[NDArray[np.uint8], ...],
    box: NDArray[np.float32],
    told: NDArray[np.float32],
    trees: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Log odds (n,) that the boxes (n, 4) show faces, by the network and by those of the `trees` (n,).

    told (n, 6): what `told_of` says of the boxes.
    """
    seen = patch_odds(model, drawn_patches(levels, box), told)
    return np.asarray(np.float32(model.trees_part) * trees + seen, np.float32)


def patch_odds(
    model: ConvolutionModel, patches: NDArray[np.uint8], told: NDArray[np.float32]
) -> NDArray[np.float32]:
    """What the network says of patches (n, 32, 32, 3), of whose boxes it is `told` (n, 6): its part of the log odds."""
    colors, brightness = relative_colors(patches)
    features = np.concatenate([told, brightness[:, None]], axis=1)
    return convolved(model, colors, np.ascontiguousarray(features))


def told_of(names: Sequence[str], values: NDArray[np.float32]) -> NDArray[np.float32]:
    """What the network is told of boxes besides their pixels, (n, 6).

    From their `values` (n, features), whose columns have these `names`.
    """
    return np.ascontiguousarray(values[:, [names.index(name) for name in PLACES]])


def relative_colors(
    patches: NDArray[np.uint8],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colours (n, 32, 32, 3) as the network sees them, and the brightness (n,) of the box in the middle.

    Logarithms of brightness, over that of the box, of R/G and of B/G.
    """
    logarithm = np.log(np.arange(256) + DARK).astype(np.float32)
    red, green, blue = (logarithm[patches[..., k]] for k in range(3))
    bright = np.log(patches.mean(axis=-1, dtype=np.float32) + np.float32(DARK))
    edge = (SIDE - INNER) // 2
    middle = bright[:, edge : edge + INNER, edge : edge + INNER].mean(axis=(1, 2))
    colors = np.stack([bright - middle[:, None, None], red - green, blue - green], axis=-1)
    return np.ascontiguousarray(colors), middle
