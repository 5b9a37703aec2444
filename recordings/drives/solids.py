"""Boxes and vehicles built from flat parts."""

from collections.abc import Iterable
from dataclasses import dataclass

from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Floats
from recordings.drives.paint.roadside import contact_shadow
from recordings.drives.paint.texture import Texture
from recordings.drives.paint.vehicles import CABIN_SLOPE, VehicleStyle
from recordings.drives.parts import UP, Group, Part, Quad

_BODY_FLOOR_M = 0.28
_CABIN_WIDTH = 0.9  # fraction of the body's width


@dataclass(frozen=True, slots=True)
class Footing:
    """Where a box stands: base centre and unit directions of its length and width; world, m."""

    centre: Floats
    forward: Floats
    right: Floats


@dataclass(frozen=True, slots=True)
class Stand:
    """Where a vehicle stands on the road; heading +1 shows its rear to the camera, -1 its front."""

    station: float
    offset: float
    heading: int


def box(
    footing: Footing,
    size: tuple[float, float],
    rise: tuple[float, float],
    faces: dict[str, Texture],
) -> list[Part]:
    """Upright box of (length, width) between two heights above its footing.

    `faces` holds textures for any of top, rear, front, left and right; the others stay open.
    """
    f, r = footing.forward * size[0], footing.right * size[1]
    low, high = rise
    top, down = footing.centre + UP * high, -UP * (high - low)
    frames = {
        "top": (top + f / 2 - r / 2, r, -f),
        "rear": (top - f / 2 - r / 2, r, down),
        "front": (top + f / 2 + r / 2, -r, down),
        "left": (top + f / 2 - r / 2, -f, down),
        "right": (top - f / 2 + r / 2, f, down),
    }
    return [Quad(*frames[name], faces[name]) for name in frames if name in faces]


def all_around(faces: Iterable[str], texture: Texture) -> dict[str, Texture]:
    """The same texture for several faces of a box."""
    return dict.fromkeys(faces, texture)


def vehicle_group(road: RoadAlignment, style: VehicleStyle, stand: Stand, name: str) -> Group:
    """A vehicle standing on the road, with the shadow below it."""
    forward, right, up = road.axes(stand.station)
    base = road.surface(stand.station, stand.offset)
    forward, right = forward * stand.heading, right * stand.heading
    footing = Footing(base, forward, right)
    length, width = style.length, style.width
    corner = base + up * 0.03 + forward * length * 0.56 - right * width * 0.62
    parts: list[Part] = [
        Quad(
            corner, right * width * 1.24, -forward * length * 1.12, contact_shadow(), two_sided=True
        )
    ]
    sides = {"left": style.left, "right": style.right}
    ends = {"front": style.front, "rear": style.rear, "top": style.roof}
    parts += box(footing, (length, width), (0.0, style.body_height), sides)
    parts += box(footing, (length, width), (_BODY_FLOOR_M, style.body_height), ends)
    if style.cabin[1] > style.cabin[0]:
        parts += _cabin(footing, style)
    return Group(style.kind, base, parts, name)


def _cabin(footing: Footing, style: VehicleStyle) -> list[Part]:
    """Cabin box with both screens leaning in."""
    first, last = style.cabin
    forward, right = footing.forward, footing.right
    middle = footing.centre + forward * style.length * (0.5 - (first + last) / 2)
    long, high = style.length * (last - first), style.height - style.body_height
    cabin = Footing(middle, forward, right)
    rise = (style.body_height, style.height)
    width = style.width * _CABIN_WIDTH
    parts = box(cabin, (long, width), rise, all_around(("left", "right"), style.cabin_side))
    parts += box(cabin, (long * (1 - CABIN_SLOPE), width), rise, {"top": style.roof})
    lean = forward * long * CABIN_SLOPE / 2
    for end, away in ((1, forward), (-1, -forward)):
        across = -right * end * style.width * _CABIN_WIDTH
        edge = middle + UP * style.height + away * long * (1 - CABIN_SLOPE) / 2
        parts.append(Quad(edge - across / 2, across, lean * end - UP * high, style.cabin_end))
    return parts
