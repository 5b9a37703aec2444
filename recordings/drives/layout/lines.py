"""Places what runs along a road: fences, wires on poles, guardrails, delineators."""

from itertools import pairwise

import numpy as np

from recordings.drives.layout.placing import LayoutPlan
from recordings.drives.paint.roadside import fence, guardrail, plain, rod
from recordings.drives.parts import UP, Quad, Sprite

_FENCE_STEP_M = 8.0
_POLE_STEP_M = 46.0
_RAIL_STEP_M = 4.0
_WIRE_PIECES = 9
_WIRE_SAG_M = 0.9
_WOOD = (98, 82, 66)


def place_lines(plan: LayoutPlan) -> None:
    """Place all linear features."""
    rng = plan.rng(22)
    if plan.spec.scene.fences:
        _fences(plan, rng)
    if plan.spec.scene.utility_side:
        _utility_line(plan, rng)
    _guardrails(plan)
    _delineators(plan, rng)


def _fences(plan: LayoutPlan, rng: np.random.Generator) -> None:
    """Wire fences on both sides, with gaps at side roads."""
    road, texture = plan.road, fence(rng)
    for t in (-38.0, 17.0) if plan.spec.road.kind == "four_lane" else (-15.0, 14.5):
        for s in np.arange(-8, plan.end + 160, _FENCE_STEP_M):
            if plan.clear_of_side_roads(s + _FENCE_STEP_M / 2):
                a, b = road.surface(s, t), road.surface(s + _FENCE_STEP_M, t)
                panel = Quad(a + UP * 1.3, b - a, -UP * 1.3, texture, two_sided=True)
                plan.add_unlisted("fence", (a + b) / 2, [panel], 160.0)


def _utility_line(plan: LayoutPlan, rng: np.random.Generator) -> None:
    """Poles with a cross-arm and three sagging wires between them."""
    road = plan.road
    away = 26.0 if plan.spec.road.kind == "four_lane" else 12.5
    t = away * plan.spec.scene.utility_side
    stations = np.arange(rng.uniform(0, 30), plan.end + 350, _POLE_STEP_M)
    wood = rod(_WOOD)
    for s in stations:
        base = road.surface(s, t)
        _, right, _ = road.axes(s)
        corner = base + UP * 9.2 - right * 1.1 + UP * 0.08
        arm = Quad(corner, right * 2.2, -UP * 0.16, plain(_WOOD), two_sided=True)
        plan.add("utility_pole", base, [Sprite(base, UP * 9.8, 0.3, wood, casts_shadow=True), arm])
    wire = plain((36, 36, 38))
    for first, last in pairwise(stations):
        for shift in (-1.0, 0.0, 1.0):
            share = np.linspace(0, 1, _WIRE_PIECES)
            points = road.surface(first + (last - first) * share, t + shift)
            points[:, 2] += 9.3 - 4 * _WIRE_SAG_M * share * (1 - share)
            for p, q in pairwise(points):
                piece = Quad(p + UP * 0.012, q - p, -UP * 0.024, wire, two_sided=True)
                plan.add_unlisted("wire", piece.origin, [piece], 200.0)


def _guardrails(plan: LayoutPlan) -> None:
    """W-beams where the specification asks for them."""
    road, rail = plan.road, guardrail()
    for start, stop, side in plan.spec.road.guardrails:
        t = side * (6.9 if plan.spec.road.kind == "four_lane" else 5.3)
        for s in np.arange(start, stop, _RAIL_STEP_M):
            a, b = road.surface(s, t), road.surface(s + _RAIL_STEP_M, t)
            beam = Quad(a + UP * 0.78, b - a, -UP * 0.8, rail, two_sided=True)
            plan.add("guardrail", (a + b) / 2, [beam])


def _delineators(plan: LayoutPlan, rng: np.random.Generator) -> None:
    """White posts with a reflector."""
    post, reflector = rod((226, 226, 220)), plain((240, 240, 240))
    edge = {"four_lane": 7.0, "street": 6.5}.get(plan.spec.road.kind, 5.6)
    for s in plan.spread(rng, plan.spec.scene.delineators, 60.0):
        base = plan.road.surface(s, edge * (1 if rng.random() < 0.7 else -1))
        lamp = Sprite(base + UP * 1.0, UP * 0.14, 0.09, reflector)
        plan.add("delineator", base, [Sprite(base, UP * 1.15, 0.06, post), lamp])
