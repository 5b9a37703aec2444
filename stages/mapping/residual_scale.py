"""How far measured centres really scatter: what one place shows, weighed against what the places before it showed."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

PRIOR_FREEDOM = 8.0
"""Weight of earlier places, in degrees of freedom: alone, five views know their scatter to a third."""
FIRST, FEWEST, MEMORY = 1.0, 5, 100
"""Factor while fewer places than that are known, and how many are remembered."""
LEAST, MOST = 0.02, 6.0


@dataclass(slots=True)
class Scatter:
    """Variance of the centres of a drive as a factor on what was assumed; always the same for the same places."""

    seen: deque[float] = field(default_factory=lambda: deque(maxlen=MEMORY))

    @property
    def usual(self) -> float:
        """Median factor of the places so far."""
        return float(np.median(self.seen)) if len(self.seen) >= FEWEST else FIRST

    def factor(self, chi: float, freedom: float) -> float:
        """Factor (variance) for a place whose residuals have this sum of squares, in sigmas, and freedom."""
        pooled = (PRIOR_FREEDOM * self.usual + chi) / (PRIOR_FREEDOM + freedom)
        return min(max(pooled, LEAST), MOST)

    def learn(self, chi: float, freedom: float) -> None:
        """Take in a place that was accepted."""
        self.seen.append(min(max(chi / freedom, LEAST), MOST))
