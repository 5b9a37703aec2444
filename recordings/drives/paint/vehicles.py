"""Vehicles made of a body box and a cabin box."""

from dataclasses import dataclass

import cv2
import numpy as np

from recordings.drives.arrays import Singles
from recordings.drives.paint.roadside import plain
from recordings.drives.paint.texture import (
    Rgb,
    Texture,
    fill_box,
    ink,
    linear,
    opaque,
    rgba,
    write_text,
)

CABIN_SLOPE = 0.32
"""Fraction of half the cabin length that the windscreen leans in."""

_PX_PER_M = 64
_CLEARANCE_M = 0.28
_PAINTS = (
    *((190, 20, 28), (236, 236, 234), (24, 26, 30), (150, 154, 160)),
    *((24, 62, 140), (226, 180, 30), (110, 20, 30), (40, 100, 70)),
)


@dataclass(frozen=True, slots=True)
class _Build:
    """Size of a kind of vehicle, metres; cabin from and to as a fraction of the length, from the front."""

    length: float
    width: float
    height: float
    body_height: float
    cabin: tuple[float, float] = (0, 0)


_BUILDS = {
    "car": _Build(4.6, 1.8, 1.45, 0.85, (0.25, 0.92)),
    "pickup": _Build(5.6, 2.0, 1.9, 1.15, (0.22, 0.58)),
    "van": _Build(5.4, 2.0, 2.2, 1.2, (0.15, 1.0)),
    "truck": _Build(14.0, 2.5, 4.0, 4.0),
    "school_bus": _Build(11.0, 2.5, 3.1, 3.1),
    "tractor": _Build(4.2, 2.2, 2.9, 1.5, (0.45, 0.95)),
}
_AXLES_M = {"truck": (1.2, 4.4, 11.6, 12.8), "school_bus": (1.6, 8.2), "tractor": (0.7, 3.2)}


@dataclass(frozen=True, slots=True)
class VehicleStyle:
    """Size (m) and textures of a vehicle; the cabin reaches from and to a fraction of the length."""

    kind: str
    length: float
    width: float
    height: float
    body_height: float
    cabin: tuple[float, float]
    left: Texture
    right: Texture
    front: Texture
    rear: Texture
    roof: Texture
    cabin_side: Texture
    cabin_end: Texture


@dataclass(frozen=True, slots=True)
class _Paint:
    """Colours of a vehicle in linear light, each (3,)."""

    body: Singles
    glass: Singles
    black: Singles
    cab: Singles


def _px(metres: float) -> int:
    return round(metres * _PX_PER_M)


def _body_color(rng: np.random.Generator, kind: str) -> Rgb:
    """A typical strong colour; school buses and tractors have their own."""
    color = _PAINTS[int(rng.integers(len(_PAINTS)))]
    if kind == "truck":
        return _PAINTS[int(rng.choice([1, 1, 0, 4]))]
    return {"school_bus": (246, 172, 14), "tractor": (34, 120, 44)}.get(kind, color)


def _side(kind: str, build: _Build, paint: _Paint) -> Singles:
    """Left side of the body, front at the left, with wheels."""
    side = np.zeros((_px(build.body_height), _px(build.length), 4), np.float32)
    rows = side.shape[0]
    floor = rows - _px(_CLEARANCE_M)
    side[:floor, :, :3], side[:floor, :, 3] = paint.body, 1
    side[floor - _px(0.12) : floor, :, :3] *= 0.5
    if kind == "truck":
        side[:, : _px(2.6), :3] = paint.cab
        side[: _px(0.9), : _px(2.4)] = 0
        side[_px(1.2) : _px(2.0), _px(0.5) : _px(1.5), :3] = paint.glass
        side[floor - _px(0.5) : floor, _px(3) : _px(9)] = 0
    if kind == "school_bus":
        side[_px(0.5) : _px(1.2), _px(1.3) :, :3] = paint.glass
        side[:, _px(1.3) :: _px(0.9), :3] = paint.body
        side[_px(1.5) : _px(1.56), :, :3] = paint.black
        side[_px(1.8) : _px(1.86), :, :3] = paint.black
    for axle in _AXLES_M.get(kind, (0.9, build.length - 1.1)):
        radius = 0.36 if kind in ("car", "pickup", "van") else 0.5
        if kind == "tractor" and axle > 2:
            radius = 0.8
        centre = (_px(axle), rows - _px(radius) - 1)
        cv2.circle(side, centre, _px(radius), ink(paint.black), -1)
        hub = linear(246, 200, 20) if kind == "tractor" else linear(150, 150, 152)
        cv2.circle(side, centre, round(radius * 0.5 * _PX_PER_M), ink(hub), -1)
    return side


def _body_end(build: _Build, paint: _Paint) -> Singles:
    """Body colour over a black bumper."""
    image = np.empty((_px(build.body_height), _px(build.width), 3), np.float32)
    image[:] = paint.body
    fill_box(image, (0, 0.86, 1, 1), paint.black)
    return image


def _front(kind: str, build: _Build, paint: _Paint) -> Texture:
    """Grille and lamps, with a windscreen where there is no cabin box."""
    image = _body_end(build, paint)
    fill_box(image, (0.25, 0.5, 0.75, 0.75), paint.black)
    for left, right in ((0.04, 0.22), (0.78, 0.96)):
        fill_box(image, (left, 0.45, right, 0.62), linear(235, 235, 225))
    if kind in ("truck", "school_bus"):
        fill_box(image, (0.08, 0.15, 0.92, 0.4), paint.glass)
    return opaque(image)


def _rear(kind: str, build: _Build, paint: _Paint) -> Texture:
    """Red lamps and a number plate."""
    image = _body_end(build, paint)
    low, high = (0.72, 0.8) if kind in ("truck", "school_bus") else (0.35, 0.6)
    for left, right in ((0.02, 0.14), (0.86, 0.98)):
        fill_box(image, (left, low, right, high), linear(190, 16, 20))
    fill_box(image, (0.4, 0.64, 0.6, 0.76), linear(225, 225, 220))
    if kind == "school_bus":
        fill_box(image, (0.15, 0.15, 0.85, 0.38), paint.glass)
        write_text(image, "SCHOOL BUS", (0.2, 0.05, 0.8, 0.12), paint.black)
    elif kind == "truck":
        fill_box(image, (0.49, 0.03, 0.51, 0.7), paint.body * 0.5)
    return opaque(image)


def _cabin(build: _Build, paint: _Paint) -> tuple[Texture, Texture]:
    """Side with two panes between sloping pillars, and windscreen."""
    rows = _px(max(build.height - build.body_height, 0.1))
    side = np.empty((rows, 160, 3), np.float32)
    side[:] = paint.body
    fill_box(side, (0.08, 0.15, 0.46, 0.92), paint.glass)
    fill_box(side, (0.54, 0.15, 0.92, 0.92), paint.glass)
    screen = np.empty((rows, 120, 3), np.float32)
    screen[:] = paint.body
    fill_box(screen, (0.08, 0.12, 0.92, 0.9), paint.glass * 1.3)
    across = np.abs(np.linspace(-1, 1, 160))[None, :]
    slope = across < 1 - CABIN_SLOPE * np.linspace(1, 0, rows)[:, None]
    return Texture(rgba(side, slope.astype(np.float32))), opaque(screen)


def vehicle(rng: np.random.Generator, kind: str) -> VehicleStyle:
    """Car, pickup, van, truck, school bus or tractor in a typical strong colour."""
    build, color = _BUILDS[kind], _body_color(rng, kind)
    paint = _Paint(linear(*color), linear(40, 50, 60), linear(18, 18, 20), linear(*_PAINTS[0]))
    side = _side(kind, build, paint)
    cabin_side, cabin_end = _cabin(build, paint)
    return VehicleStyle(
        kind=kind,
        length=build.length,
        width=build.width,
        height=build.height,
        body_height=build.body_height,
        cabin=build.cabin,
        left=Texture(side),
        right=Texture(side[:, ::-1]),
        front=_front(kind, build, paint),
        rear=_rear(kind, build, paint),
        roof=plain(color),
        cabin_side=cabin_side,
        cabin_end=cabin_end,
    )
