"""Errors of ties: how large they are by their residuals, and the effect of those that neighbours share.

Patches near each other lie on the same surface and are imaged by the same part of the lens, so their errors are
correlated. The part of such a field of errors that resembles motion is absorbed by the fit, so its size is given.
"""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from wayside.stages.kernels import Array, Numbers


class TieErrors(NamedTuple):
    """Errors of registered ties, measured."""

    sigma_px: float = 0.08
    """Standard deviation of a coordinate."""
    shared_px: float = 0.05
    """Standard deviation of the error that neighbouring ties share: scatter of rotations and directions."""
    shared_fraction: float = 0.004
    """Added to that, as a fraction of the displacement by travel."""
    reach_px: float = 60.0
    """Reach of the correlation."""


TIE_ERRORS = TieErrors()
SCATTER_QUANTILE = 0.75
"""Quantile that is compared: by the median, errors of directions are raised too little."""


def tie_scatter(distance_px: Array, sigma_px: float = TIE_ERRORS.sigma_px) -> float:
    """How many times larger the errors of the ties of a step are than stated, by their Sampson distances (n,).

    A quantile of the distances, in stated standard deviations, over that of a normal distribution: how large gross
    errors are does not matter (Huber, Robust Statistics, section 5). At least 1, also without ties: what is compared is
    the error that each tie has alone. The one that neighbours share is absorbed by the fit, hardly shows, and is taken
    to grow with it: both are errors of registering patches in the same light.
    """
    if len(distance_px) == 0:
        return 1.0
    normal = NormalDist().inv_cdf((1 + SCATTER_QUANTILE) / 2)
    found = float(np.sort(np.abs(distance_px))[int(SCATTER_QUANTILE * len(distance_px))])
    return max(1.0, found / sigma_px / normal)


def correlated_sigma_px(displacement_px: Array, errors: TieErrors = TIE_ERRORS) -> Array:
    """Scatter (n,) of the error that ties share with their neighbours, by their displacement through travel, pixels.

    Directions of travel depend on few near ties, mostly on the road, which slide along markings or are biased towards
    the motion by which they were searched for.
    """
    return np.asarray(errors.shared_px + errors.shared_fraction * displacement_px)


def correlated_covariance(position: Array, image: Numbers, effect: Array, reach_px: float) -> Array:
    """Covariance (k, k) of an estimate by smooth random fields of errors, one in each image, independent of each other.

    `position` (n, 2), `image` (n,): place of each tie in its image, px, and number of that image.
    `effect` (n, 2, k): change of the estimate per standard deviation of the field, in both coordinates of each tie.
    `reach_px`: of the correlation exp(-d^2 / (2 reach_px^2)).
    """
    result = np.zeros((effect.shape[2], effect.shape[2]))
    for own in np.unique(image):
        place, by_tie = position[image == own] / reach_px, effect[image == own]
        alike = np.exp(-0.5 * cdist(place, place, "sqeuclidean"))
        result += np.tensordot(by_tie, np.tensordot(alike, by_tie, 1), ([0, 1], [0, 1]))
    return 0.5 * (result + result.T)  # the same to the last digit on both sides of the diagonal
