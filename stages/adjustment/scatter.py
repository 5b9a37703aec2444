"""Scale of errors by the residuals that they leave. Stated errors hold in good light, and an image may be worse."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from wayside.stages.adjustment.correlated_errors import TIE_ERRORS
from wayside.stages.kernels import Array

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
    quantile = SCATTER_QUANTILE
    normal = NormalDist().inv_cdf((1 + quantile) / 2)
    return max(
        1.0, float(np.quantile(np.abs(distance_px), quantile)) / TIE_ERRORS.sigma_px / normal
    )
