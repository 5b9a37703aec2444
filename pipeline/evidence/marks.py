"""How classes look, and the figures of a sign in words, for sheets and the index alike."""

import math
from dataclasses import dataclass
from typing import Any

from wayside.pipeline.code_words import (
    code_of,
    nominal_words,
    posts_words,
    series_words,
    system_words,
)
from wayside.schemas.detections import COLOR_RGB

Ink = tuple[int, int, int]
Outline = tuple[tuple[float, float], ...]

UNKNOWN_INK: Ink = (150, 156, 164)
UNKNOWN = "unknown"


def _regular(corners: int, first_rad: float) -> Outline:
    """A regular polygon in the unit circle; y down."""
    angles = [first_rad + 2 * math.pi * i / corners for i in range(corners)]
    return tuple((math.cos(angle), math.sin(angle)) for angle in angles)


_SHIELD: Outline = (
    (-0.85, -0.8), (-0.45, -0.7), (0.0, -0.95), (0.45, -0.7), (0.85, -0.8),
    (0.9, 0.05), (0.65, 0.55), (0.0, 0.95), (-0.65, 0.55), (-0.9, 0.05),
)  # fmt: skip
_CROSSBUCK: Outline = (
    (-0.95, -0.65), (-0.65, -0.95), (0.0, -0.3), (0.65, -0.95), (0.95, -0.65), (0.3, 0.0),
    (0.95, 0.65), (0.65, 0.95), (0.0, 0.3), (-0.65, 0.95), (-0.95, 0.65), (-0.3, 0.0),
)  # fmt: skip
OUTLINES: dict[str, Outline] = {
    "rectangle": ((-0.72, -0.92), (0.72, -0.92), (0.72, 0.92), (-0.72, 0.92)),
    "diamond": _regular(4, 0.0),
    "octagon": _regular(8, math.pi / 8),
    "triangle": ((-0.95, -0.8), (0.95, -0.8), (0.0, 0.85)),
    "circle": _regular(32, 0.0),
    "pentagon": ((0.0, -0.92), (0.9, -0.1), (0.9, 0.9), (-0.9, 0.9), (-0.9, -0.1)),
    "pennant": ((-0.95, -0.7), (0.95, 0.0), (-0.95, 0.7)),
    "shield": _SHIELD,
    "crossbuck": _CROSSBUCK,
    "other": _regular(6, 0.0),
}
"""Corners between -1 and 1, x right, y down."""


def ink_of(color: str | None) -> Ink:
    """Colour to paint a class in; grey where it is not known."""
    return UNKNOWN_INK if color is None else COLOR_RGB[color]


def css(color: str | None) -> str:
    """The ink of a class of colours as CSS has it."""
    return "#{:02x}{:02x}{:02x}".format(*ink_of(color))


def outline_of(shape: str | None) -> Outline:
    """Outline to paint a class with; a hexagon where it is not known."""
    return OUTLINES["other" if shape is None else shape]


def class_words(name: str | None) -> str:
    """A class as a person says it."""
    return "unknown" if name is None else name.replace("_", " ")


def appearance_of(color: str | None, shape: str | None) -> str:
    """Colour and shape in one phrase."""
    return f"{class_words(color)} {class_words(shape)}" if color or shape else "look unknown"


@dataclass(frozen=True, slots=True)
class Units:
    """Of lengths on pages, and of sizes of panels (`short`), each with its metres."""

    long: str
    metres: float
    short: str
    short_metres: float
    digits: int

    def length(self, value_m: float) -> str:
        """A length in words."""
        return f"{value_m / self.metres:z.2f} {self.long}"

    def size(self, value_m: float) -> str:
        """A width or height in words."""
        return f"{value_m / self.short_metres:z.{self.digits}f} {self.short}"


METRIC, US = Units("m", 1.0, "m", 1.0, 2), Units("ft", 0.3048, "in", 0.0254, 1)
UNITS = {"metric": METRIC, "us": US}
"""By the values of `--units`."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One line: what, its value with unit, and its standard deviation or a remark."""

    label: str
    value: str
    remark: str = ""


def figures_of(sign: dict[str, Any], world: str, units: Units = METRIC) -> dict[str, list[Figure]]:
    """All figures of a row of `signs.parquet` by heading; `world`: name of the world frame, from `run.json`."""
    return {
        "Position": [*_beside_the_road(sign, units), *_in_the_world(sign, world, units)],
        "Panel": _panel(sign, units),
        "Measurement": _measurement(sign),
    }


def route_words(sign: dict[str, Any]) -> str | None:
    """Route and measure of a sign or panel, such as "US-36 EB, 12.346 mi"; None without a measure."""
    if sign.get("measure") is None:
        return None
    at = f"{sign['measure']:.3f} {sign['measure_unit']}"
    return f"{sign['route']}, {at}" if sign["route"] else at


def _beside_the_road(sign: dict[str, Any], units: Units) -> list[Figure]:
    route, lateral = route_words(sign), sign["lateral_m"]
    side = "" if lateral is None else ", right" if lateral >= 0 else ", left"
    beside, ground = None if lateral is None else abs(lateral), sign.get("ground_m")
    rows = [
        ("Along the road", sign["station_m"], sign["sigma_along_m"]),
        (f"Beside the path{side}", beside, sign["sigma_lateral_m"]),
        ("Centre above the road", sign["up_m"], sign["sigma_up_m"]),
        ("Lower edge above it", sign["bottom_m"], sign["sigma_bottom_m"]),
    ]
    if ground is not None and sign["bottom_m"] is not None:
        rows.append(("and above the ground below", sign["bottom_m"] - ground, None))
    if sign["spacing_m"] is not None:
        rows.append(("To the next of its type", sign["spacing_m"], sign["sigma_spacing_m"]))
    found = [] if route is None else [Figure("Route", route)]
    found += [_length(units, *row) for row in rows]
    if sign.get("posts") is not None:
        found.append(Figure("Stands on", *posts_words(sign["posts"], units.size)))
    return found


def _in_the_world(sign: dict[str, Any], world: str, units: Units) -> list[Figure]:
    variances = sign["covariance"]
    sigmas = [None] * 3 if variances is None else [variances[i] ** 0.5 for i in (0, 3, 5)]
    axes = ("East", "North", "Up") if world == "enu" else ("World x", "World y", "World z")
    rows = zip(axes, (sign[a] for a in "xyz"), sigmas, strict=True)
    found = [_length(units, *row) for row in rows]
    if sign["lon_deg"] is not None and sign["lat_deg"] is not None:
        for label, name, side in (("Latitude", "lat", "north"), ("Longitude", "lon", "east")):
            sigma = sign[f"sigma_{side}_m"]
            within = "" if sigma is None else f"± {units.length(sigma)}"
            found.append(Figure(label, f"{sign[f'{name}_deg']:.7f}°", within))
    return found


def _panel(sign: dict[str, Any], units: Units) -> list[Figure]:
    code, series, nominal = code_of(sign), series_words(sign), nominal_words(sign)
    found = [Figure("Code", UNKNOWN)]
    if code is not None:
        probability = f"probability {sign['code_probability']:.2f}"
        found = [Figure("Code", f"{code} ({system_words(sign)})", probability)]
        found += [] if series is None else [Figure("Series", series)]
    found += [
        Figure("Colour", class_words(sign["color"])),
        Figure("Shape", class_words(sign["shape"])),
        _length(units, "Width", sign["panel_width_m"], sign["sigma_width_m"], size=True),
        _length(units, "Height", sign["panel_height_m"], sign["sigma_height_m"], size=True),
    ]
    found += [] if nominal is None else [Figure("Standard size", nominal)]
    facing = UNKNOWN if sign["facing_deg"] is None else f"{sign['facing_deg']:z.0f}°"
    sigma = sign["sigma_facing_deg"]
    return [*found, Figure("Facing", facing, "" if sigma is None else f"± {sigma:.0f}°")]


def _measurement(sign: dict[str, Any]) -> list[Figure]:
    frames = f"frames {sign['first_frame']} to {sign['last_frame']}"
    residual = UNKNOWN if sign["residual_px"] is None else f"{sign['residual_px']:.2f} px"
    found = [Figure("Views", str(sign["views"]), frames), Figure("Residual, RMS", residual)]
    if name := sign.get("image_name"):
        found.append(Figure("Best image", name, sign["image_date"]))
    for name in ("color", "shape"):
        if (distance := sign[f"{name}_distance"]) is not None:
            found.append(Figure(f"Mahalanobis distance, {name}", f"{distance:.1f}"))
    return found


def _length(
    units: Units, label: str, value: float | None, sigma: float | None = None, *, size: bool = False
) -> Figure:
    words = units.size if size else units.length
    within = "" if sigma is None else f"± {words(sigma)}"
    return Figure(label, UNKNOWN if value is None else words(value), within)
