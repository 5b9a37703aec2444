"""Puts up one support with its sign panels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from recordings.drives.arrays import Floats, Singles
from recordings.drives.layout.placing import LayoutPlan
from recordings.drives.layout.vegetation import Foliage
from recordings.drives.paint.posts import varied_post
from recordings.drives.paint.roadside import rod
from recordings.drives.paint.texture import Texture, linear, rgba
from recordings.drives.parts import UP, Part, PlacedSign, Quad, Sprite
from recordings.drives.signs.ageing import aged
from recordings.drives.signs.catalogue import Assembly
from recordings.drives.spec import SignSpec

REACH_M = 420.0
_FACE_BEFORE_POST_M = 0.06
_BOTTOM_M = {
    "mile_post": (1.0, 1.3),
    "object_marker": (0.9, 1.3),
    "chevron": (1.2, 1.5),
    "eu_town_end": (0.6, 1.8),
}
_ON_TWO_LEGS = ("eu_board", "eu_town_end")
_POSTS = {
    "wood": ((122, 98, 72), 0.11),
    "round_metal": ((150, 152, 152), 0.065),
    "u_channel": ((92, 104, 92), 0.075),
    "steel_beam": ((120, 122, 122), 0.16),
}
"""sRGB colour and width (m)."""
_KINDS = ("wood", "round_metal", "u_channel", "steel_beam", "pole")
_ALONE, _IN_PAIRS = (0.28, 0.27, 0.27, 0.06, 0.12), (0.28, 0.18, 0.18, 0.36, 0.0)
"""Shares of posts that vary: beams stand in pairs under large panels, poles alone."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where an assembly stands and which way it faces before it is twisted.

    `normal` is horizontal; `forward` is whether it is for the camera's direction of travel. Panels on a gantry
    hang with their lower edge `overhead_m` above the road, straight, without posts of their own.
    """

    station: float
    offset: float
    normal: Floats
    forward: bool
    overhead_m: float | None = None


@dataclass(frozen=True, slots=True)
class _Stance:
    """Unit vectors along the width of the panels, up the post and out of the faces; and the state they are in."""

    across: Floats
    stem: Floats
    facing: Floats
    faded: bool
    hidden: bool


def _stance(rng: np.random.Generator, mix: SignSpec, place: Place) -> _Stance:
    """How an assembly is twisted and leans."""
    twisted, leaning = rng.random() < mix.twisted_share, rng.random() < mix.leaning_share
    faded, hidden = rng.random() < mix.faded_share, rng.random() < mix.hidden_share
    yaw = rng.uniform(-15, 15) if twisted else rng.normal(0, 2.0)
    roll = rng.uniform(-6, 6) if leaning else rng.normal(0, 0.6)
    pitch = rng.uniform(-5, 5) if leaning else rng.normal(0, 0.6)
    if place.overhead_m is not None:
        yaw, roll, pitch, hidden = rng.normal(0, 1.0), 0.0, 0.0, False
    a, (east, north, _) = np.radians(yaw), place.normal
    normal = np.array(
        [east * np.cos(a) - north * np.sin(a), east * np.sin(a) + north * np.cos(a), 0]
    )
    level = np.cross(-normal, UP)
    stem = UP + np.tan(np.radians(roll)) * level + np.tan(np.radians(pitch)) * normal
    stem /= np.linalg.norm(stem)
    across = level - (level @ stem) * stem
    across /= np.linalg.norm(across)
    return _Stance(across, stem, np.cross(-stem, across), faded, hidden and place.forward)


def _bottom(rng: np.random.Generator, panels: Assembly) -> float:
    """Height of the lowest edge above the road surface, m."""
    kinds = {face.kind for face, _ in panels}
    usual = _BOTTOM_M.get(next(iter(kinds)), (1.5, 2.3)) if len(kinds) == 1 else (1.5, 2.3)
    bottom = rng.uniform(*usual)
    if "eu_beacon" in kinds:
        return rng.uniform(0.2, 0.9)
    return rng.uniform(1.7, 2.0) if "crossbuck" in kinds else bottom


def _post(rng: np.random.Generator, width: float) -> str:
    """A post that can carry a panel of that width (m)."""
    if width > 1.3:
        return str(rng.choice(["steel_beam", "wood"]))
    return str(rng.choice(["wood", "u_channel", "round_metal", "round_metal"]))


def widest(panels: Assembly) -> float:
    """Width of the widest panel, m."""
    return max(face.width for face, _ in panels)


@dataclass(frozen=True, slots=True)
class _Mount:
    """A support before its panels: foot (world, m), length along the stem to the uppermost edge, kind of post.

    Its posts: none under a gantry. `thick`: their width in m where they are varied, else 0.
    """

    foot: Floats
    stance: _Stance
    length: float
    post: str
    posts: Sequence[Part] = ()
    thick: float = 0.0

    def on_posts(self, panels: Assembly, vary: np.random.Generator | None) -> Self:
        """On one post, or two under a panel that is too wide for one; varied by a random stream where there is one."""
        if self.post not in _POSTS:
            return self
        (color, thick), post, above = _POSTS[self.post], self.post, -0.04
        on_two = panels[0][0].kind in _ON_TWO_LEGS
        limit, share = (1.05, 0.46) if on_two else (1.3, 0.3)
        width = widest(panels)
        spread = [0.0] if width <= limit else [-share * width, share * width]
        if vary is not None:
            alone = len(spread) == 1
            post = str(vary.choice(_KINDS, p=_ALONE if alone else _IN_PAIRS))
            above = vary.uniform(0.5, 4.0) if post == "pole" else above
            spread += [0.0] if len(spread) > 1 and vary.random() < width / 9 else []
            texture, thick = varied_post(post, self.length + above, vary)
        else:
            texture = rod(color)
        axis = self.stance.stem * (self.length + above)
        feet = (self.foot + self.stance.across * x for x in spread)
        posts = [Sprite(foot, axis, thick, texture, casts_shadow=True) for foot in feet]
        return replace(self, post=post, posts=posts, thick=0.0 if vary is None else thick)


def _bare_back(front: Quad, rng: np.random.Generator) -> Quad:
    """Grey metal behind a panel."""
    alpha = front.texture.levels[0][:, ::-1, 3]
    bare = np.empty((*alpha.shape, 3), np.float32)
    bare[:] = linear(*(np.array([138, 141, 143]) * rng.uniform(0.85, 1.1)))
    return Quad(front.origin + front.u, -front.u, front.v, Texture(rgba(bare, alpha)))


@dataclass(frozen=True, slots=True)
class Assembler:
    """Puts up assemblies; `dapple` is the tile of light that falls through leaves, if there is any.

    `vary`: random stream of posts that vary; None: all posts of a kind are alike.
    """

    plan: LayoutPlan
    foliage: Foliage
    dapple: Singles | None
    vary: np.random.Generator | None = None

    def put_up(self, rng: np.random.Generator, panels: Assembly, place: Place) -> None:
        """Add one support with its panels, and at times a bush before them."""
        road = self.plan.road
        stance = _stance(rng, self.plan.spec.signs, place)
        foot = road.surface(place.station, place.offset)
        road_z = float(road.surface(place.station, road.travel_offset_m)[2])
        total = sum(face.height + gap for face, gap in panels)
        if place.overhead_m is None:
            bottom, post = _bottom(rng, panels), _post(rng, widest(panels))
        else:
            bottom, post = place.overhead_m, "gantry"
        length = (road_z + bottom + total - foot[2]) / stance.stem[2]
        mount = _Mount(foot, stance, length, post).on_posts(panels, self.vary)
        fronts, backs = self._panels(rng, panels, mount, place.forward)
        parts = [*backs, *mount.posts, *fronts]
        self.plan.add_unlisted("sign", foot, parts, REACH_M)
        if stance.hidden:
            self._hide(rng, place, road_z + bottom, total)

    def _panels(
        self, rng: np.random.Generator, panels: Assembly, mount: _Mount, forward: bool
    ) -> tuple[list[Part], list[Part]]:
        """Fronts and backs of the panels, from the top of a mount downwards."""
        plan, stance = self.plan, mount.stance
        plan.assemblies += 1
        shade = None
        if self.dapple is not None:
            row, column = rng.integers(0, 440, 2)
            shade = self.dapple[row : row + 40, column : column + 40]
        fronts: list[Part] = []
        backs: list[Part] = []
        height = mount.length
        for face, gap in panels:
            height -= gap
            top = mount.foot + stance.stem * height
            texture = Texture(aged(face, rng, stance.faded, shade))
            front = Quad(
                origin=top - stance.across * face.width / 2 + stance.facing * _FACE_BEFORE_POST_M,
                u=stance.across * face.width,
                v=-stance.stem * face.height,
                texture=texture,
                sign_id=len(plan.signs) + 1,
                casts_shadow=True,
                fill=float(texture.levels[0][..., 3].mean()),
            )
            fronts.append(front)
            backs.append(_bare_back(front, rng))
            plan.signs.append(
                PlacedSign(
                    sign_id=front.sign_id,
                    assembly_id=plan.assemblies,
                    face=face,
                    quad=front,
                    post=mount.post,
                    posts=len(mount.posts),
                    post_width=mount.thick,
                    forward=forward,
                    hidden=stance.hidden,
                    faded=stance.faded,
                )
            )
            height -= face.height
        return fronts, backs

    def _hide(self, rng: np.random.Generator, place: Place, bottom_z: float, total: float) -> None:
        """Add a bush between the camera and a sign of a total height (m) whose lower edge is at a height."""
        before, side = rng.uniform(1.5, 4.0), rng.uniform(-0.7, 0.3)
        base = self.plan.road.surface(place.station - before, place.offset + side)
        height = bottom_z + total * rng.uniform(0.25, 0.6) - base[2]
        width = height * rng.uniform(0.6, 0.9)
        texture = self.foliage.pick(rng, "bush")
        self.plan.add("bush", base, [Sprite(base, UP * height, width, texture, casts_shadow=True)])
