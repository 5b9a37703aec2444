"""The whole scene of a drive."""

import numpy as np

from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Singles
from recordings.drives.layout.assembly import Assembler
from recordings.drives.layout.lines import place_lines
from recordings.drives.layout.placing import LayoutPlan
from recordings.drives.layout.signs import place_signs
from recordings.drives.layout.structures import place_structures
from recordings.drives.layout.traffic import place_traffic
from recordings.drives.layout.vegetation import Foliage, plant_vegetation
from recordings.drives.paint.noise import noise_tile
from recordings.drives.poses import TimedPose
from recordings.drives.scene import Scene
from recordings.drives.spec import DriveSpec


def build_scene(spec: DriveSpec, road: RoadAlignment, poses: list[TimedPose]) -> Scene:
    """Everything that stands or drives along a road, as far as the images of a drive reach."""
    plan = LayoutPlan(spec, road, end=poses[-1].station_m)
    foliage, dapple = Foliage(plan.rng(20), spec.scene.season), _dapple(spec)
    vary = plan.rng(12) if spec.signs.varied_posts else None
    place_signs(plan, Assembler(plan, foliage, dapple, vary))
    plant_vegetation(plan, foliage)
    place_lines(plan)
    place_structures(plan)
    place_traffic(plan)
    return Scene(road, plan.signs, plan.groups, plan.movers, dapple)


def _dapple(spec: DriveSpec) -> Singles | None:
    """Periodic tile of the light that falls through leaves, 1 where it is full."""
    if spec.light.dapple <= 0:
        return None
    tile = noise_tile(np.random.default_rng([spec.seed, 2]), 512, 1.3, 6.0, 90.0)
    lit = np.clip((tile + 0.1) * 1.6 + 0.5, 0, 1)
    shade: Singles = (1 - spec.light.dapple * (1 - lit)).astype(np.float32)
    return shade
