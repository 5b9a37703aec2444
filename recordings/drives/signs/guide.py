"""Green, blue and brown signs that guide, of the United States."""

import numpy as np

from recordings.drives.signs.face import INCH, Face, bordered, panel, pick

_PLACES = (
    "SALINA|HAYS|GREAT BEND|LYONS|HUTCHINSON|WICHITA|PRATT|LARNED|NEWTON|ELLIS|OSBORNE|LINCOLN"
    "|RUSSELL|KINSLEY|STAFFORD|MARION"
).split("|")
_STREETS = ("MAIN ST", "OAK AVE", "2ND ST", "ELM ST", "PRAIRIE RD", "COUNTY RD 12", "WALNUT ST")


def _green(kind: str, w: float, h: float, border: float) -> Face:
    return bordered(kind, "green", "rectangle", (w, h), "white", (border, 0.0))


def guide_distances(rng: np.random.Generator) -> Face:
    """Green panel with two or three towns and miles."""
    count = int(rng.integers(2, 4))
    w, h = float(rng.uniform(2.0, 3.0)), 0.42 * count + 0.2
    face = _green("guide_distances", w, h, 0.03)
    for i, town in enumerate(rng.choice(_PLACES, count, replace=False)):
        y = 0.1 + 0.42 * (i + 0.5)
        face.text(str(town), (w * 0.4, y), 0.2, "white", w * 0.6)
        face.text(str(int(rng.integers(3, 90))), (w * 0.87, y), 0.2, "white", w * 0.16)
    return face


def guide_destination(rng: np.random.Generator) -> Face:
    """Green panel with a town and an arrow."""
    w, h = float(rng.uniform(1.6, 2.4)), float(rng.uniform(0.5, 0.8))
    face = _green("guide_destination", w, h, 0.025)
    face.text(pick(rng, _PLACES), (w * 0.42, h / 2), h * 0.38, "white", w * 0.62)
    to_the_right = [(w * 0.8, h * 0.5), (w * 0.95, h * 0.5)]
    ahead = [(w * 0.87, h * 0.82), (w * 0.87, h * 0.15)]
    face.arrow(to_the_right if rng.random() < 0.6 else ahead, "white", 0.05)
    return face


def guide_large(rng: np.random.Generator) -> Face:
    """Green freeway-size panel, about 10 by 6 ft."""
    w, h = float(rng.uniform(2.7, 3.3)), float(rng.uniform(1.6, 2.0))
    face = _green("guide_large", w, h, 0.045)
    face.text(pick(rng, _PLACES), (w / 2, h * 0.3), 0.28, "white", w * 0.8)
    number = int(rng.integers(10, 260))
    face.text(f"EXIT {number}", (w * 0.42, h * 0.66), 0.26, "white", w * 0.55)
    face.arrow([(w * 0.76, h * 0.82), (w * 0.9, h * 0.52)], "white", 0.07)
    return face


def gantry_panel(rng: np.random.Generator) -> Face:
    """Green overhead panel."""
    w, h = float(rng.uniform(3.2, 4.2)), float(rng.uniform(1.8, 2.4))
    face = _green("guide_overhead", w, h, 0.05)
    face.text(pick(rng, _PLACES), (w / 2, h * 0.28), 0.36, "white", w * 0.8)
    below = pick(rng, ["1/2 MILE", "EXIT ONLY", "NEXT RIGHT"])
    face.text(below, (w / 2, h * 0.58), 0.24, "white", w * 0.7)
    face.arrow([(w / 2, h * 0.74), (w / 2, h * 0.93)], "white", 0.07)
    return face


def street_name(rng: np.random.Generator) -> Face:
    """Narrow green street-name blade."""
    name = pick(rng, _STREETS)
    w = float(rng.uniform(0.75, 1.2))
    face = _green("street_name", w, 9 * INCH, 0.01)
    face.text(name, (w / 2, 4.5 * INCH), 5 * INCH, "white", w * 0.86)
    return face


def city_limit(rng: np.random.Generator) -> Face:
    """Green city-limit panel."""
    w, h = 48 * INCH, 24 * INCH
    face = _green("city_limit", w, h, 0.02)
    face.lines([pick(rng, _PLACES), "CITY LIMIT"], "white", h * 0.12, h * 0.9)
    return face


def mile_post(rng: np.random.Generator) -> Face:
    """Narrow vertical green mile marker."""
    w, h = float(pick(rng, [6, 8, 10])) * INCH, float(pick(rng, [18, 27])) * INCH
    face = _green("mile_post", w, h, 0.008)
    face.text("MILE", (w / 2, h * 0.12), h * 0.1, "white", w * 0.8)
    for i, digit in enumerate(str(int(rng.integers(100, 400)))):
        face.text(digit, (w / 2, h * (0.34 + 0.24 * i)), h * 0.19, "white", w * 0.6)
    return face


def service(rng: np.random.Generator) -> Face:
    """Blue service square."""
    s = float(pick(rng, [24, 30])) * INCH
    face = panel("service", "blue", (s, s), "white")
    word = pick(rng, ["H", "H", "GAS", "FOOD", "LODGING", "PHONE", "CAMPING"])
    height = s * (0.6 if len(word) == 1 else 0.28)
    face.text(word, (s / 2, s / 2), height, "white", s * 0.8, 0.2)
    return face


def service_large(rng: np.random.Generator) -> Face:
    """Blue panel with words or logo plates."""
    w, h = float(rng.uniform(1.4, 2.4)), float(rng.uniform(0.9, 1.5))
    face = bordered("service_large", "blue", "rectangle", (w, h), "white", (0.025, 0.0))
    if rng.random() < 0.5:
        words = pick(rng, [["ADOPT", "A HIGHWAY"], ["REST AREA", "2 MILES"], ["INFO", "CENTER"]])
        face.lines(words, "white", h * 0.12, h * 0.9)
        return face
    face.text(pick(rng, ["FOOD", "GAS", "LODGING"]), (w / 2, h * 0.17), h * 0.16, "white")
    for i in range(2):
        x = w * (0.08 + 0.46 * i)
        plate = pick(rng, ["white", "red", "yellow", "brown"])
        face.box(x, h * 0.32, x + w * 0.38, h * 0.9, plate)
    return face


def recreation(rng: np.random.Generator) -> Face:
    """Brown recreation panel."""
    w, h = float(rng.uniform(1.2, 2.2)), float(rng.uniform(0.6, 1.1))
    face = bordered("recreation", "brown", "rectangle", (w, h), "white", (0.02, 0.0))
    options = [["STATE PARK", "3 MILES"], ["HISTORIC", "SITE"], ["LAKE", "WILSON"], ["MUSEUM"]]
    face.lines(pick(rng, options), "white", h * 0.12, h * 0.9)
    return face
