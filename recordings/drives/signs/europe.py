"""Signs of the European kind (Vienna Convention shapes)."""

import numpy as np

from recordings.drives.signs.face import Face, bordered, pick

_DISC_M = 0.6
_TRIANGLE_M = 0.9


def eu_limit(rng: np.random.Generator) -> Face:
    """Red ring around white, number."""
    s = _DISC_M
    face = Face("eu_speed_limit", "white", "circle", s, s, secondary=("red", "black"))
    face.disc(s / 2, s / 2, s / 2, "red")
    face.disc(s / 2, s / 2, s * 0.385, "white")
    limit = str(pick(rng, [30, 50, 60, 70, 80]))
    face.text(limit, (s / 2, s / 2), s * 0.3, "black", s * 0.6, 0.2)
    return face


def eu_no_overtaking(rng: np.random.Generator) -> Face:
    """Red ring, two cars."""
    s = _DISC_M
    face = Face("eu_no_overtaking", "white", "circle", s, s, secondary=("red", "black"))
    face.disc(s / 2, s / 2, s / 2, "red")
    face.disc(s / 2, s / 2, s * 0.4, "white")
    for x, ink in ((0.38, "red"), (0.62, "black")):
        face.box(s * (x - 0.09), s * 0.45, s * (x + 0.09), s * 0.6, ink)
        roof = ((x - 0.06, 0.38), (x + 0.06, 0.38), (x + 0.08, 0.46), (x - 0.08, 0.46))
        face.fill([(s * u, s * v) for u, v in roof], ink)
    face.legend = "no overtaking"
    return face


def eu_no_entry(rng: np.random.Generator) -> Face:
    """Red disc, white bar."""
    s = _DISC_M
    face = bordered("eu_no_entry", "red", "circle", (s, s), "white", (0.012, 0.006))
    face.box(s * 0.14, s * 0.41, s * 0.86, s * 0.59, "white")
    return face


def eu_warning(rng: np.random.Generator) -> Face:
    """Red-bordered white triangle, point up."""
    s = _TRIANGLE_M
    face = Face("eu_warning", "white", "triangle_up", s, s * 0.866, secondary=("red", "black"))
    face.border("red", 0.085, 0.0)
    kind = pick(rng, ["bang", "bend", "cross"])
    if kind == "bang":
        face.line([(s * 0.5, s * 0.34), (s * 0.5, s * 0.54)], "black", 0.06)
        face.disc(s * 0.5, s * 0.64, 0.035, "black")
    elif kind == "bend":
        path = [(s * 0.42, s * 0.68), (s * 0.47, s * 0.52), (s * 0.56, s * 0.38)]
        face.arrow(path, "black", 0.05)
    else:
        face.line([(s * 0.5, s * 0.36), (s * 0.5, s * 0.68)], "black", 0.05)
        face.line([(s * 0.38, s * 0.54), (s * 0.62, s * 0.54)], "black", 0.05)
    face.legend = kind
    return face


def eu_give_way(rng: np.random.Generator) -> Face:
    """Red-bordered white triangle, point down."""
    size = (_TRIANGLE_M, _TRIANGLE_M * 0.866)
    return bordered("eu_give_way", "white", "triangle", size, "red", (0.085, 0.0))


def eu_priority(rng: np.random.Generator) -> Face:
    """Yellow diamond in a white one."""
    face = Face("eu_priority", "yellow", "diamond", 0.7, 0.7, secondary=("white", "black"))
    face.border("white", 0.06, 0.0)
    face.border("black", 0.012, 0.06)
    return face


def eu_mandatory(rng: np.random.Generator) -> Face:
    """Blue disc, white arrow."""
    s = _DISC_M
    face = bordered("eu_mandatory", "blue", "circle", (s, s), "white", (0.012, 0.006))
    aside, ahead = [(0.3, 0.3), (0.68, 0.68)], [(0.5, 0.8), (0.5, 0.2)]
    path = aside if rng.random() < 0.5 else ahead
    face.arrow([(s * x, s * y) for x, y in path], "white", 0.07)
    face.legend = "arrow"
    return face


def eu_crossing(rng: np.random.Generator) -> Face:
    """Blue square, white triangle, walker."""
    s = _DISC_M
    face = Face("eu_crossing", "blue", "rectangle", s, s, secondary=("white", "black"))
    face.border("white", 0.01, 0.008)
    face.fill([(s * 0.5, s * 0.14), (s * 0.88, s * 0.84), (s * 0.12, s * 0.84)], "white")
    face.line([(s * 0.5, s * 0.42), (s * 0.49, s * 0.6), (s * 0.4, s * 0.78)], "black", 0.035)
    face.line([(s * 0.49, s * 0.6), (s * 0.6, s * 0.78)], "black", 0.035)
    face.disc(s * 0.5, s * 0.36, 0.025, "black")
    face.legend = "crossing"
    return face


def eu_parking(rng: np.random.Generator) -> Face:
    """Blue square with P."""
    s = _DISC_M
    face = bordered("eu_parking", "blue", "rectangle", (s, s), "white", (0.01, 0.008))
    face.text("P", (s / 2, s / 2), s * 0.62, "white", s * 0.5, 0.18)
    return face


def eu_town(rng: np.random.Generator) -> Face:
    """Yellow town-name panel."""
    w, h = float(rng.uniform(1.0, 1.3)), 0.65
    face = bordered("eu_town", "yellow", "rectangle", (w, h), "black", (0.018, 0.012))
    town = pick(rng, ["NEUDORF", "ALTHEIM", "SEEBACH", "LINDAU"])
    face.lines([town, "KREIS OST"], "black", h * 0.12, h * 0.88)
    return face


def eu_beacon(rng: np.random.Generator) -> Face:
    """Tall panel with one to three stripes, rising to one side: so far to the crossing; often the metres above."""
    w, h = 0.3, 1.0
    ground, ink = ("blue", "white") if rng.random() < 0.15 else ("white", "red")
    face = Face("eu_beacon", ground, "rectangle", w, h, secondary=(ink,))
    count = int(rng.integers(1, 4))
    rise = 0.14 if rng.random() < 0.7 else -0.14
    numbered = rng.random() < 0.6
    top = 0.28 if numbered else 0.0
    pitch = rng.uniform(0.19, 0.24)
    thick = rng.uniform(0.08, 0.11)
    middle = h - (count / 2) * pitch - 0.04 if numbered else h / 2
    for k in range(count):
        y = middle + pitch * (k - (count - 1) / 2)
        left, right = y + (rise - thick) / 2, y - (rise + thick) / 2
        face.fill([(0, left), (w, right), (w, right + thick), (0, left + thick)], ink)
    if numbered:
        digits = "black" if ground == "white" else "white"
        face.text(str(80 * count), (w / 2, top * 0.36), 0.085, digits, w * 0.7)
        face.text("M", (w / 2, top * 0.78), 0.06, digits, w * 0.3)
    if rng.random() < 0.5:
        face.border("grey" if ground == "white" else "white", 0.012)
    face.legend = f"{count} stripes"
    return face


def eu_town_end(rng: np.random.Generator) -> Face:
    """End of a town: next towns on white above, this town on yellow crossed out in red; or the latter alone."""
    w, h = float(rng.uniform(0.95, 1.4)), float(rng.uniform(0.6, 0.75))
    town = pick(rng, ["NEUDORF", "ALTHEIM", "SEEBACH", "LINDAU"])
    face = bordered("eu_town_end", "yellow", "rectangle", (w, h), "black", (0.018, 0.012))
    face.secondary = ("white", "red", "black")
    alone = rng.random() < 0.3
    split = 0.0 if alone else h * rng.uniform(0.42, 0.5)
    if not alone:
        face.box(0.03, 0.03, w - 0.03, split, "white")
        names = [town] if rng.random() < 0.5 else [town, "HOCHSTADT"]
        for k, name in enumerate(names):
            y = 0.03 + (split - 0.03) * (k + 0.5) / len(names)
            face.text(name, (w * 0.42, y), h * 0.26 / len(names) + 0.02, "black", w * 0.6, 0.18)
        face.arrow([(w * 0.87, split - 0.04), (w * 0.87, 0.1)], "black", 0.025)
    face.text("BERGEN", (w / 2, (split + h) / 2), h * 0.2, "black", w * 0.8, 0.18)
    face.line([(0.03, h - 0.04), (w - 0.03, split + 0.04)], "red", 0.04)
    return face


def eu_board(rng: np.random.Generator) -> Face:
    """Direction board: places, at times an arrow; mostly white."""
    w, h = float(rng.uniform(0.9, 1.5)), float(rng.uniform(0.35, 0.75))
    ground = pick(rng, ["white", "white", "white", "yellow", "blue", "green"])
    ink = "black" if ground in ("white", "yellow") else "white"
    face = bordered("eu_board", ground, "rectangle", (w, h), ink, (0.015, 0.01))
    places = ["ZENTRUM", "BAHNHOF", "MESSE", "KLINIK", "HAFEN", "STADION"]
    if rng.random() < 0.4:
        y = h / 2
        face.arrow([(w * 0.1, y), (w * 0.28, y)], ink, 0.035)
        face.text(pick(rng, places), (w * 0.64, y), min(h * 0.3, 0.16), ink, w * 0.55)
    else:
        face.lines([pick(rng, places), pick(rng, places)], ink, h * 0.14, h * 0.86)
    return face
