"""Plants trees, windbreaks, forest, bushes and weeds."""

from dataclasses import dataclass

import numpy as np

from recordings.drives.layout.placing import LayoutPlan
from recordings.drives.paint.foliage import Plant, foliage
from recordings.drives.paint.texture import Texture
from recordings.drives.parts import UP, Sprite

_VARIANTS: dict[Plant, int] = {"broad": 5, "conifer": 2, "bush": 4, "weed": 4}
_HEIGHTS_M: dict[Plant, tuple[float, float]] = {
    "broad": (5, 13),
    "conifer": (3, 8),
    "bush": (0.6, 2.6),
    "weed": (0.3, 0.9),
}
_ASPECTS: dict[Plant, tuple[float, float]] = {
    "broad": (0.75, 1.1),
    "conifer": (0.5, 0.8),
    "bush": (0.9, 1.8),
    "weed": (0.8, 1.3),
}


class Foliage:
    """Pool of plants to choose from."""

    def __init__(self, rng: np.random.Generator, season: float) -> None:
        self._pool = {
            kind: [foliage(rng, kind, season) for _ in range(count)]
            for kind, count in _VARIANTS.items()
        }

    def pick(self, rng: np.random.Generator, kind: Plant) -> Texture:
        """One of the plants of a kind."""
        return self._pool[kind][int(rng.integers(_VARIANTS[kind]))]


@dataclass(frozen=True, slots=True)
class _Planter:
    """Plants one thing after the other from one random stream."""

    plan: LayoutPlan
    rng: np.random.Generator
    pool: Foliage

    def plant(self, station: float, offset: float, kind: Plant) -> None:
        """One tree, bush or weed; trees of a forest are taller."""
        low, high = _HEIGHTS_M[kind]
        tall = self.plan.spec.road.kind == "forest" and high > 5
        height = self.rng.uniform(low, high) * (1.45 if tall else 1.0)
        base = self.plan.road.surface(station, offset)
        base[2] -= 0.05
        texture = self.pool.pick(self.rng, kind)
        width = height * self.rng.uniform(*_ASPECTS[kind])
        sprite = Sprite(base, UP * height, width, texture, casts_shadow=kind != "weed")
        if kind == "weed":
            self.plan.add_unlisted("weed", base, [sprite], 120.0)
        else:
            self.plan.add("bush" if kind == "bush" else "tree", base, [sprite], 700.0)

    def side(self, share_right: float) -> int:
        """+1 for the right of the road, -1 for the left."""
        return 1 if self.rng.random() < share_right else -1

    def tree(self, share_broad: float) -> Plant:
        """A broad-leaved tree in a fraction of the cases, else a conifer."""
        return "broad" if self.rng.random() < share_broad else "conifer"


def plant_vegetation(plan: LayoutPlan, pool: Foliage) -> None:
    """Plant everything that grows."""
    scene, kind, rng = plan.spec.scene, plan.spec.road.kind, plan.rng(21)
    planter = _Planter(plan, rng, pool)
    right = {"four_lane": 20.0, "street": 12.0}.get(kind, 14.0)
    left = {"four_lane": 30.0, "street": 12.0}.get(kind, 14.0)
    for station in plan.spread(rng, scene.trees):
        side = planter.side(0.5)
        offset = (right if side > 0 else left) + rng.gamma(1.5, 14.0)
        if plan.clear_of_side_roads(station) or offset > 30:
            planter.plant(station, side * offset, planter.tree(0.75))
    for station in plan.spread(rng, scene.forest):
        offset = (8.6 + rng.gamma(1.3, 8.0)) * planter.side(0.5)
        planter.plant(station, offset, planter.tree(0.6))
    for station in plan.spread(rng, scene.bushes):
        offset = (right - 3.5 + rng.gamma(1.4, 6.0)) * planter.side(0.55)
        if plan.clear_of_side_roads(station):
            beyond_median = 8 if kind == "four_lane" and offset < 0 else 0
            planter.plant(station, offset - beyond_median, "bush")
    for station in plan.spread(rng, scene.weeds * 4, 60.0):
        verge = {"four_lane": 9.5, "street": 9.2, "forest": 6.2}.get(kind, 6.6)
        offset = (verge + rng.gamma(1.5, 2.2)) * planter.side(0.6)
        in_median = kind == "four_lane" and offset < 0
        if plan.clear_of_side_roads(station, 5.0) and not in_median:
            planter.plant(station, offset, "weed")
