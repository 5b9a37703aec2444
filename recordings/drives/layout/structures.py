"""Places shops, silos, billboards, bridges and the small things along a road."""

import numpy as np

from recordings.drives.layout.barns import build
from recordings.drives.layout.placing import LayoutPlan
from recordings.drives.paint.buildings import billboard, shop_front, silo, wall
from recordings.drives.paint.roadside import bale, barrel, grainy, plain, rod
from recordings.drives.parts import UP, Part, Quad, Sprite
from recordings.drives.solids import Footing, all_around, box

_SILO_PAINTS = ((206, 208, 210), (60, 84, 130), (190, 186, 176))
_MAILBOX_PAINTS = ((180, 30, 34), (30, 70, 150), (220, 220, 214), (30, 34, 36), (40, 110, 60))
_BRIDGE_SPAN_M = 90.0
_DISTANT_REACH_M = 900.0
_FAR_REACH_M = 700.0


def place_structures(plan: LayoutPlan) -> None:
    """Place everything that was built, and bales and barrels."""
    rng = plan.rng(23)
    _buildings(plan, rng)
    _silos(plan, rng)
    _shops(plan, rng)
    _billboards(plan, rng)
    _mailboxes(plan, rng)
    _bales(plan, rng)
    _barrels(plan, rng)
    for station in plan.spec.road.bridges:
        _overpass(plan, station)


def _side(rng: np.random.Generator) -> int:
    """+1 for the right of the road, -1 for the left."""
    return 1 if rng.random() < 0.5 else -1


def _near_m(plan: LayoutPlan) -> float:
    """Distance of the nearest buildings from the centre line."""
    return {"four_lane": 34.0, "street": 16.0}.get(plan.spec.road.kind, 26.0)


def _buildings(plan: LayoutPlan, rng: np.random.Generator) -> None:
    other_carriageway = 14.0 if plan.spec.road.kind == "four_lane" else 0.0
    for s in plan.spread(rng, plan.spec.scene.buildings):
        side = _side(rng)
        away = _near_m(plan) + rng.gamma(1.5, 12.0) + (other_carriageway if side < 0 else 0)
        kind, base, parts = build(plan.road, rng, s, side * away)
        plan.add(kind, base, parts, _DISTANT_REACH_M)


def _silos(plan: LayoutPlan, rng: np.random.Generator) -> None:
    for s in plan.spread(rng, plan.spec.scene.silos):
        offset = _side(rng) * (_near_m(plan) + 14 + rng.gamma(1.5, 25.0))
        base = plan.road.surface(s, offset)
        texture = silo(_SILO_PAINTS[int(rng.integers(3))])
        height = rng.uniform(9, 24)
        width = height * 0.34
        along, _, _ = plan.road.axes(s)
        feet = [base + along * k * height * 0.34 for k in range(int(rng.integers(1, 4)))]
        row = [Sprite(foot, UP * height, width, texture) for foot in feet]
        plan.add("silo", base, row, _DISTANT_REACH_M)


def _shops(plan: LayoutPlan, rng: np.random.Generator) -> None:
    for s in plan.spread(rng, plan.spec.scene.shops, 120.0):
        side = _side(rng)
        forward, right, _ = plan.road.axes(s)
        base = plan.road.surface(s, side * 17.5)
        bricks = wall(rng, (150, 120, 100), (300, 150), rib=6)
        faces = all_around(("front", "rear"), bricks)
        faces |= {"left": shop_front(rng), "right": shop_front(rng)}
        rise = (0, rng.uniform(4.5, 7.5))
        plan.add("shop", base, box(Footing(base, forward, right), (14, 12), rise, faces))


def _billboards(plan: LayoutPlan, rng: np.random.Generator) -> None:
    road, kind = plan.road, plan.spec.road.kind
    for s in plan.spread(rng, plan.spec.scene.billboards, 250.0):
        side = _side(rng)
        away = rng.uniform(15, 40)
        away += 22 if kind == "four_lane" and side < 0 else 0
        away += 6 if kind == "street" else 0
        base = road.surface(s, side * away)
        width = rng.uniform(3.5, 9.0)
        height, low = width * 0.38, rng.uniform(1.8, 4.5)
        forward, right, _ = road.axes(s)
        turn = np.radians(rng.uniform(-15, 15))
        u = (right * np.cos(turn) + forward * np.sin(turn)) * width
        u[2] = 0
        post, top = rod((110, 96, 80)), UP * (low + height)
        corner = base - u / 2 + top
        parts: list[Part] = [
            Sprite(base + u * k, top, 0.25, post, casts_shadow=True) for k in (-0.35, 0, 0.35)
        ]
        parts.append(Quad(corner + u, -u, -UP * height, plain((120, 110, 96))))
        parts.append(Quad(corner, u, -UP * height, billboard(rng), casts_shadow=True))
        plan.add("billboard", base, parts, _FAR_REACH_M)


def _mailboxes(plan: LayoutPlan, rng: np.random.Generator) -> None:
    away = {"street": 6.6, "four_lane": 9.4}.get(plan.spec.road.kind, 5.4)
    for s in plan.spread(rng, plan.spec.scene.mailboxes, 80.0):
        forward, right, _ = plan.road.axes(s)
        base = plan.road.surface(s, _side(rng) * away)
        paint = plain(_MAILBOX_PAINTS[int(rng.integers(len(_MAILBOX_PAINTS)))])
        faces = all_around(("front", "rear", "left", "right", "top"), paint)
        post = Sprite(base, UP * 1.05, 0.1, rod((110, 88, 64)))
        tray = Footing(base + UP * 1.05, right, -forward)
        plan.add("mailbox", base, [post, *box(tray, (0.5, 0.22), (0, 0.26), faces)])


def _bales(plan: LayoutPlan, rng: np.random.Generator) -> None:
    for s in plan.spread(rng, plan.spec.scene.bales, 150.0):
        base = plan.road.surface(s, _side(rng) * rng.uniform(18, 60))
        plan.add("hay_bale", base, [Sprite(base, UP * 1.5, 1.5, bale(rng), casts_shadow=True)])


def _barrels(plan: LayoutPlan, rng: np.random.Generator) -> None:
    drum = barrel()
    edge = 4.4 if plan.spec.road.kind == "four_lane" else 4.3
    for s in plan.spread(rng, plan.spec.scene.barrels, 60.0):
        base = plan.road.surface(s, edge + rng.uniform(0, 0.4))
        plan.add("barrel", base, [Sprite(base, UP * 1.0, 0.55, drum, casts_shadow=True)])


def _overpass(plan: LayoutPlan, station: float) -> None:
    """Concrete bridge over the road."""
    road, rng = plan.road, plan.rng(24)
    forward, (_, right, _) = road.level_forward(station), road.axes(station)
    base = road.surface(station, 0.0)
    deck = wall(rng, (178, 174, 164), (800, 60), rib=14)
    dark = grainy((96, 94, 90), rng, 0.05)
    pier = {"rear": deck, "left": dark, "right": dark}
    parts: list[Part] = []
    for t in (-13.0, 13.0):
        foot = road.surface(station, t)
        rise = (0, 5.9 - foot[2] + base[2])
        parts += box(Footing(foot, forward, right), (9, 1.0), rise, pier)
    span = right * _BRIDGE_SPAN_M
    corner = base + UP * 5.7 + forward * 5 - right * _BRIDGE_SPAN_M / 2
    parts.append(Quad(corner, span, -forward * 10, dark, two_sided=True))
    footing = Footing(base, forward, right)
    parts += box(footing, (10, _BRIDGE_SPAN_M), (5.7, 7.3), {"rear": deck})
    plan.add("bridge", base, parts)
