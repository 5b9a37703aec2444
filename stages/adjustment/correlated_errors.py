"""Errors of ties: how large they are by their residuals, and the effect of those that neighbours share.

Patches near each other lie on the same surface and are imaged by the same part of the lens, so their errors are
correlated. The part of such a field of errors that resembles motion is absorbed by the fit, so its size is given.
"""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled


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


def tie_scatter(distance_px: Array) -> float:
    """How many times larger the errors of the ties of a step are than stated, by their Sampson distances (n,).

    A quantile of the distances, in stated standard deviations, over that of a normal distribution: how large gross
    errors are does not matter (Huber, Robust Statistics, section 5). At least 1, also without ties: what is compared is
    the error that each tie has alone. The one that neighbours share is absorbed by the fit, hardly shows, and is taken
    to grow with it: both are errors of registering patches in the same light.
    """
    if len(distance_px) == 0:
        return 1.0
    normal = NormalDist().inv_cdf((1 + SCATTER_QUANTILE) / 2)
    found = float(np.quantile(np.abs(distance_px), SCATTER_QUANTILE))
    return max(1.0, found / TIE_ERRORS.sigma_px / normal)


def correlated_sigma_px(displacement_px: Array, errors: TieErrors = TIE_ERRORS) -> Array:
    """Scatter (n,) of the error that ties share with their neighbours, by their displacement through travel, pixels.

    Directions of travel depend on few near ties, mostly on the road, which slide along markings or are biased towards
    the motion by which they were searched for.
    """
    return np.asarray(errors.shared_px + errors.shared_fraction * displacement_px)


def correlated_covariance(
    position: Array, image: NDArray[np.int64], effect: Array, reach_px: float
) -> Array:
    """Covariance (k, k) of an estimate by smooth random fields of errors, one in each image, independent of each other.

    position (n, 2): of ties in their images, px. image (n,): number of that image. effect (n, 2, k): change of the
    estimate by one standard deviation of the field in both coordinates of each tie. reach_px: of the correlation
    exp(-d^2 / (2 reach_px^2)).
    """
    order = np.argsort(image, kind="stable")
    first = np.flatnonzero(np.diff(image[order], prepend=-1)).astype(np.int64)
    result = np.zeros((effect.shape[2], effect.shape[2]))
    _correlated_covariance(
        np.append(first, len(order)),
        np.ascontiguousarray(position[order]),
        np.ascontiguousarray(effect[order]),
        0.5 / reach_px**2,
        result,
    )
    return result


@compiled
def _correlated_covariance(
    first: NDArray[np.int64], position: Array, effect: Array, sharpness: float, result: Array
) -> None:
    count = effect.shape[2]
    total = np.empty((2, count))
    for p in range(first.shape[0] - 1):
        for i in range(first[p], first[p + 1]):
            for k in range(count):
                total[0, k], total[1, k] = 0.5 * effect[i, 0, k], 0.5 * effect[i, 1, k]
            for j in range(first[p], i):
                x, y = position[i, 0] - position[j, 0], position[i, 1] - position[j, 1]
                near = sharpness * (x * x + y * y)
                if near > 12.0:
                    continue
                alike = np.exp(-near)
                for k in range(count):
                    total[0, k] += alike * effect[j, 0, k]
                    total[1, k] += alike * effect[j, 1, k]
            for k in range(count):
                for m in range(count):
                    both = effect[i, 0, k] * total[0, m] + effect[i, 1, k] * total[1, m]
                    result[k, m] += both
                    result[m, k] += both
