"""Keeping images about a given distance apart."""

from __future__ import annotations

import math

from wayside.schemas.frame import EARTH_RADIUS_M, Fix, PosePrior, turn_deg

Position = tuple[str, tuple[float, float, float]]


def position_of(pose: PosePrior | None, fix: Fix | None) -> Position | None:
    """Where an image was taken: by its pose ("pose", x, y, z), else by its fix; None where neither is known."""
    if pose is not None:
        x, y, z = pose.pose.centre.tolist()
        return "pose", (x, y, z)
    if fix is not None:
        return "fix", (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
    return None


def distance_m(first: Position | None, second: Position | None) -> float | None:
    """Straight distance between two positions of the same kind; None where they cannot be compared."""
    if first is None or second is None or first[0] != second[0]:
        return None
    if first[0] == "pose":
        return math.dist(first[1], second[1])
    # Fixes are compared in the plane: their heights jitter most and tell nothing of the way along the road.
    (lat_a, lon_a, _), (lat_b, lon_b, _) = first[1], second[1]
    east = math.radians(turn_deg(lon_a, lon_b)) * math.cos(math.radians((lat_a + lat_b) / 2))
    north = math.radians(lat_b - lat_a)
    return EARTH_RADIUS_M * math.hypot(east, north)


STANDING_NS, STANDING_SHARE = 1_000_000_000, 0.25
"""Where positions stand still, within this share of the distance, an image a second is used all the same: positions may
be wrong, and only images tell whether the camera moves."""


class Thinning:
    """Decides which images are used, so that used ones are about `thin_m` apart.

    An image is used where its distance from the last used one, plus half of the latest step, reaches `thin_m`: of two
    neighbours the one nearer to the wanted place. The distance is measured straight from the last used
    image and never summed up, so that jitter while standing still adds up to nothing.
    """

    def __init__(self, thin_m: float, spacing_m: float) -> None:
        self.thin_m, self.spacing_m = thin_m, spacing_m
        self.used: tuple[int, Position | None] | None = None
        self.latest: tuple[int, Position | None] | None = None
        self.used_ns = 0

    def keeps(self, number: int, position: Position | None, time_ns: int) -> bool:
        """Whether the image is used; `number` counts the images taken, `position` where it is known."""
        here = number, position
        latest, self.latest = self.latest, here
        if self.used is not None and latest is not None and self.thin_m > 0:
            way, step = self._between(self.used, here), self._between(latest, here)
            is_near = way is not None and way + (step or 0.0) / 2 < self.thin_m
            stands = way is not None and way < STANDING_SHARE * self.thin_m
            if is_near and not (stands and time_ns - self.used_ns >= STANDING_NS):
                return False
        self.used, self.used_ns = here, time_ns
        return True

    def _between(
        self, first: tuple[int, Position | None], second: tuple[int, Position | None]
    ) -> float | None:
        way = distance_m(first[1], second[1])
        if way is None and self.spacing_m:
            return self.spacing_m * (second[0] - first[0])
        return way
