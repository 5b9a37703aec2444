"""Scale of errors by the residuals that they leave: stated errors are those of good light, an image may be worse."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from wayside.schemas.settings import TieSettings
from wayside.stages.kernels import Array


def residual_scatter(pulls: Array, quantile: float) -> float:
    """How many times larger errors are than stated; at least 1, also where there are none.

    A quantile of the absolute residuals (n,), in stated standard deviations, over that of a normal distribution: how
    large gross errors are does not matter (Huber, Robust Statistics, section 5). Stated errors are never lowered: those
    that neighbours share hardly show in residuals, since the fit follows them.
    """
    if len(pulls) == 0:
        return 1.0
    normal = NormalDist().inv_cdf((1 + quantile) / 2)
    return max(1.0, float(np.quantile(np.abs(pulls), quantile)) / normal)


def tie_scatter(distance_px: Array, settings: TieSettings) -> float:
    """How many times larger the errors of the ties of a step are than stated, by their Sampson distances (n,).

    What is compared is the error that each tie has alone. The one that neighbours share is absorbed by the fit, and
    taken to grow with it: both are errors of registering patches in the same light.
    """
    return residual_scatter(distance_px / settings.sigma_px, settings.scatter_quantile)
