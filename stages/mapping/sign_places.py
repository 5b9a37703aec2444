"""Where the signs of a drive stand: along the carriageway, whatever its width, and over it.

How far from the path depends on the road and on the lane: 3 m on a village street, 20 m on the left lane of a freeway.
The expectation before the first sign is broad and the same on both sides. Each sign that its own images show sharpens
it for later ones on the same drive.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, log, pi, sqrt

from wayside.stages.geometry import FrenetOffset

ASIDE_M, ASIDE_WIDTH_M = 9.0, 8.0
"""Middle and half width at half height of the distance from the path: carriageways of one to six lanes."""
ABOVE_M, ABOVE_SIGMA_M = 2.0, 2.5
"""Mean and deviation of the height above the camera: from plates at its height to boards over the road."""
LEAST_DENSITY = 1e-5
"""Per square metre: nowhere is impossible."""
LIKE_RIGHT_M, LIKE_RIGHT_SHARE, LIKE_ABOVE_M = 3.0, 0.1, 1.5
"""How far signs of one road scatter about each other, deviations: sideways at least and as a share of the distance
from the path (the error of the motion grows with it), and in height."""
PRIOR_SIGNS = 5.0
"""So many signs weigh as much as what was expected before the first."""
SURE = 5.5
"""Box score (log odds) at which a landmark counts as half a sign: of 70 above it on nine real drives 63 were signs."""
SAME_M = 1.5
"""Places nearer to each other are one support: it tells nothing of itself."""


@dataclass(slots=True)
class SignPlaces:
    """The places of the signs of a drive so far: (right, above, station, weight), metres."""

    known: list[tuple[float, float, float, float]] = field(default_factory=list)

    def add(self, offset: FrenetOffset, score: float) -> None:
        """Count a landmark by its box score, not by all evidence: its own place must not confirm itself."""
        weight = 1 / (1 + exp(SURE - score))
        self.known.append((offset.right, offset.above, offset.station, weight))

    def log_density(self, offset: FrenetOffset) -> float:
        """Logarithm of the density of signs, per square metre across the path, at an offset from it."""
        right, above = offset.right, offset.above
        aside = 1 / (1 + ((abs(right) - ASIDE_M) / ASIDE_WIDTH_M) ** 2) / (2 * pi * ASIDE_WIDTH_M)
        prior = max(aside * _normal(above - ABOVE_M, ABOVE_SIGMA_M), LEAST_DENSITY)
        sigma = max(LIKE_RIGHT_M, LIKE_RIGHT_SHARE * abs(right))
        total, signs = PRIOR_SIGNS * prior, PRIOR_SIGNS
        for other_right, other_above, station, weight in self.known:
            if abs(station - offset.station) > SAME_M or abs(other_right - right) > SAME_M:
                near = _normal(other_right - right, sigma)
                total += weight * near * _normal(other_above - above, LIKE_ABOVE_M)
                signs += weight
        return log(total / signs)


def _normal(gap: float, sigma: float) -> float:
    return exp(-0.5 * (gap / sigma) ** 2) / (sigma * sqrt(2 * pi))
