"""Yellow, orange and fluorescent signs that warn, of the United States."""

import numpy as np

from recordings.drives.signs.face import INCH, Face, bordered, panel, pick
from recordings.drives.signs.symbols import draw_symbol

_WARNINGS = (
    *("curve_right", "curve_left", "turn_right", "crossroad", "side_road", "winding"),
    *("stop_ahead", "signal", "deer", "tractor", "BUMP", "DIP", "NARROW|BRIDGE", "LOW|SHOULDER"),
    *("NO|OUTLET", "ROAD|NARROWS", "pedestrian"),
)
_WORKS = (
    *("ROAD|WORK|AHEAD", "ONE LANE|ROAD|AHEAD", "FLAGGER|AHEAD", "LOOSE|GRAVEL"),
    "UNEVEN|LANES",
)


def _diamond(kind: str, color: str, symbol: str, inches: float) -> Face:
    """Diamond; the width is the diagonal of the square panel."""
    size = inches * INCH * np.sqrt(2)
    face = bordered(kind, color, "diamond", (size, size), "black", (0.02, 0.014))
    draw_symbol(face, symbol, "black")
    face.legend = symbol.replace("|", " ")
    return face


def warning(rng: np.random.Generator) -> Face:
    """Yellow diamond."""
    symbol = pick(rng, _WARNINGS)
    return _diamond("warning_diamond", "yellow", symbol, float(pick(rng, [30, 30, 36])))


def advisory(rng: np.random.Generator) -> Face:
    """Yellow advisory speed plaque."""
    s = float(pick(rng, [18, 24])) * INCH
    face = panel("advisory_speed", "yellow", (s, s), "black")
    speed = str(pick(rng, [25, 35, 40, 45]))
    face.text(speed, (s / 2, s * 0.4), s * 0.42, "black", s * 0.75, 0.2)
    face.text("MPH", (s / 2, s * 0.8), s * 0.17, "black", s * 0.6)
    return face


def chevron(right: bool) -> Face:
    """Yellow chevron rectangle pointing into the curve."""
    w, h = 24 * INCH, 30 * INCH
    legend = "right" if right else "left"
    face = Face("chevron", "yellow", "rectangle", w, h, legend=legend, secondary=("black",))
    points = [(0.2, 0.1), (0.52, 0.1), (0.84, 0.5), (0.52, 0.9), (0.2, 0.9), (0.5, 0.5)]
    face.fill([((x if right else 1 - x) * w, y * h) for x, y in points], "black")
    return face


def large_arrow(rng: np.random.Generator) -> Face:
    """Yellow rectangle with a long arrow."""
    w, h = 48 * INCH, 24 * INCH
    face = panel("large_arrow", "yellow", (w, h), "black")
    points = [(w * 0.12, h * 0.5), (w * 0.88, h * 0.5)]
    face.arrow(points if rng.random() < 0.5 else points[::-1], "black", h * 0.2)
    return face


def no_passing_pennant(rng: np.random.Generator) -> Face:
    """Yellow pennant."""
    w, h = 46 * INCH, 36 * INCH
    face = bordered("no_passing_zone", "yellow", "pennant", (w, h), "black", (0.02, 0.014))
    for i, word in enumerate(("NO", "PASSING", "ZONE")):
        face.text(word, (w * 0.33, h * (0.36 + 0.14 * i)), h * 0.095, "black", w * 0.4)
    return face


def rail_advance(rng: np.random.Generator) -> Face:
    """Yellow disc with X and R R."""
    s = 36 * INCH
    face = bordered("rail_advance", "yellow", "circle", (s, s), "black", (0.022, 0.012))
    face.line([(s * 0.2, s * 0.2), (s * 0.8, s * 0.8)], "black", s * 0.08)
    face.line([(s * 0.8, s * 0.2), (s * 0.2, s * 0.8)], "black", s * 0.08)
    for x in (0.22, 0.78):
        face.text("R", (s * x, s * 0.5), s * 0.2, "black")
    return face


def school(rng: np.random.Generator) -> Face:
    """Fluorescent pentagon."""
    s = 36 * INCH
    face = bordered(
        "school", "fluorescent_yellow_green", "pentagon", (s, s), "black", (0.02, 0.014)
    )
    draw_symbol(face, "children", "black")
    face.legend = "children"
    return face


def school_plaque(rng: np.random.Generator) -> Face:
    """Fluorescent plaque under a school sign."""
    word = pick(rng, ["AHEAD", "SCHOOL", "500 FT"])
    size = (24 * INCH, 10 * INCH)
    return panel("school_plaque", "fluorescent_yellow_green", size, "black", [word])


def pedestrian(rng: np.random.Generator) -> Face:
    """Fluorescent diamond."""
    return _diamond("pedestrian_diamond", "fluorescent_yellow_green", "pedestrian", 30)


def work_diamond(rng: np.random.Generator) -> Face:
    """Orange diamond."""
    return _diamond("work_diamond", "orange", pick(rng, _WORKS), float(pick(rng, [36, 48])))


def work_panel(rng: np.random.Generator) -> Face:
    """Orange rectangle."""
    lines = pick(rng, [["END", "ROAD WORK"], ["DETOUR"], ["ROAD WORK", "NEXT 5 MILES"]])
    return panel("work_panel", "orange", (48 * INCH, 24 * INCH), "black", lines)


def object_marker(rng: np.random.Generator) -> Face:
    """Yellow and black diagonal stripes."""
    w, h = 12 * INCH, 36 * INCH
    face = Face("object_marker", "yellow", "rectangle", w, h, secondary=("black",))
    for y in np.arange(-w, h + w, 0.2):
        face.fill([(0, y), (w, y + w), (w, y + w + 0.1), (0, y + 0.1)], "black")
    return face
