"""Scale of residuals: what one landmark shows, pooled with what those before it showed."""

from __future__ import annotations

from collections import deque

import numpy as np

from wayside.schemas.settings import LandmarkSettings


class ResidualScale:
    """Variance of the centres of a drive's boxes, as a factor on what was assumed."""

    def __init__(self, settings: LandmarkSettings) -> None:
        self._settings = settings
        self._seen: deque[float] = deque(maxlen=settings.scale_memory)

    @property
    def usual(self) -> float:
        """Median factor of the landmarks so far; 1 while there are few."""
        few = len(self._seen) < self._settings.scale_fewest
        return 1.0 if few else float(np.median(self._seen))

    def factor(self, chi_square: float, degrees_of_freedom: float) -> float:
        """Factor (variance) of a landmark with this sum of squared residuals in sigmas."""
        prior = self._settings.scale_prior_freedom
        return self._limited((prior * self.usual + chi_square) / (prior + degrees_of_freedom))

    def learn(self, chi_square: float, degrees_of_freedom: float) -> None:
        """Take in a landmark that was accepted."""
        self._seen.append(self._limited(chi_square / degrees_of_freedom))

    def _limited(self, factor: float) -> float:
        return min(max(factor, self._settings.scale_least), self._settings.scale_most)
