"""What a drive is made of: textured surfaces in groups, and signs."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from recordings.drives.arrays import Floats
from recordings.drives.paint.texture import Texture
from recordings.drives.signs.face import Face

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Quad:
    """Planar textured parallelogram: origin (top left), u to the right, v down; world, m.

    It is seen from the side towards which v x u points.
    """

    origin: Floats
    u: Floats
    v: Floats
    texture: Texture
    sign_id: int = 0  # 1-based on the front of a sign
    two_sided: bool = False
    casts_shadow: bool = False
    fill: float = 1.0  # fraction of the parallelogram that the panel covers

    def normal(self) -> Floats:
        """Unit normal (3,) towards the visible side."""
        n = np.cross(self.v, self.u)
        return n / np.linalg.norm(n)

    def corners(self) -> Floats:
        """Four corners (4, 3) in order."""
        o = self.origin
        return np.array([o, o + self.u, o + self.u + self.v, o + self.v])


@dataclass(frozen=True, slots=True)
class Sprite:
    """Upright image that always turns to the camera: base (world, m), axis from base to top, width."""

    base: Floats
    axis: Floats
    width: float
    texture: Texture
    casts_shadow: bool = False

    def quad(self, eye: Floats) -> Quad:
        """The quad seen from a world point."""
        return self.quad_across(np.cross(self.base - eye, self.axis))

    def quad_across(self, right: Floats) -> Quad:
        """The quad with its width along a direction."""
        right = right * (self.width / np.linalg.norm(right))
        origin = self.base + self.axis - right / 2
        return Quad(origin, right, -self.axis, self.texture, two_sided=True)

    def corners(self) -> Floats:
        """Corners (8, 3) of a cross that bounds the sprite from every side."""
        half = self.width / 2
        around = np.array([[half, 0, 0], [-half, 0, 0], [0, half, 0], [0, -half, 0]])
        return np.concatenate([self.base + around, self.base + self.axis + around])


Part: TypeAlias = Quad | Sprite


@dataclass(frozen=True, slots=True)
class Group:
    """Parts drawn together, in order, at the depth of their anchor (world, m)."""

    kind: str
    anchor: Floats
    parts: list[Part]
    distractor: str = ""  # identifier in the truth, empty when not listed
    reach_m: float = 500.0

    def corners(self) -> Floats:
        """World points (n, 3) that bound the group."""
        return np.concatenate([part.corners() for part in self.parts])


@dataclass(frozen=True, slots=True)
class PlacedSign:
    """One placed panel."""

    sign_id: int  # 1-based
    assembly_id: int
    face: Face
    quad: Quad
    post: str
    posts: int  # on which it stands
    post_width: float  # m; 0: that of all posts of this kind
    forward: bool  # placed for the camera's direction of travel
    hidden: bool
    faded: bool

    def outline(self) -> list[Floats]:
        """World outlines (n, 3) of the panel, one for each of its polygons."""
        size = np.array([self.face.width, self.face.height])
        sides = np.stack([self.quad.u, self.quad.v])
        return [self.quad.origin + (np.array(o) / size) @ sides for o in self.face.outlines]

    def centre(self) -> Floats:
        """Panel centre (3,), world, m."""
        return self.quad.origin + self.quad.u / 2 + self.quad.v / 2
