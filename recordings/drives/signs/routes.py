"""Route markers of the United States."""

import numpy as np

from recordings.drives.signs.face import INCH, Face, bordered, panel, pick


def us_route(rng: np.random.Generator) -> Face:
    """White route shield."""
    s = 24 * INCH
    face = bordered("us_route", "white", "shield", (s, s), "black", (0.022, 0.008))
    number = str(pick(rng, [36, 50, 54, 56, 77, 81, 183, 281]))
    face.text(number, (s / 2, s * 0.52), s * 0.42, "black", s * 0.72, 0.2)
    return face


def interstate(rng: np.random.Generator) -> Face:
    """Blue and red route shield."""
    s = 24 * INCH
    face = Face("interstate", "blue", "shield", s, s, secondary=("red", "white"))
    face.box(0, 0, s, s * 0.26, "red")
    face.box(0, s * 0.26, s, s * 0.29, "white")
    number = str(pick(rng, [35, 70, 135]))
    face.text(number, (s / 2, s * 0.58), s * 0.38, "white", s * 0.7, 0.2)
    return face


def state_route(rng: np.random.Generator) -> Face:
    """Sunflower marker: yellow disc on black square."""
    s = 24 * INCH
    face = Face("state_route", "yellow", "rectangle", s, s, secondary=("black",))
    face.fill(face.outlines[0], "black")
    for angle in np.arange(16) * np.pi / 8:
        tip = (s / 2 + s * 0.48 * np.cos(angle), s / 2 + s * 0.48 * np.sin(angle))
        face.line([(s / 2, s / 2), tip], "yellow", s * 0.15)
    face.disc(s / 2, s / 2, s * 0.4, "yellow")
    number = str(pick(rng, [4, 14, 15, 18, 96, 156]))
    face.text(number, (s / 2, s / 2), s * 0.34, "black", s * 0.62, 0.2)
    return face


def county_route(rng: np.random.Generator) -> Face:
    """Blue pentagon."""
    s = 18 * INCH
    face = bordered("county_route", "blue", "pentagon", (s, s), "yellow", (0.018, 0.01))
    number = str(int(rng.integers(100, 999)))
    face.text(number, (s / 2, s * 0.56), s * 0.26, "yellow", s * 0.66)
    return face


def route_plaque(rng: np.random.Generator) -> Face:
    """White cardinal-direction plaque."""
    word = pick(rng, ["NORTH", "SOUTH", "EAST", "WEST", "JCT"])
    return panel("route_plaque", "white", (24 * INCH, 12 * INCH), "black", [word])


def route_arrow(rng: np.random.Generator) -> Face:
    """White arrow plaque."""
    w, h = 21 * INCH, 15 * INCH
    face = panel("route_arrow", "white", (w, h), "black")
    points = [(w * 0.2, h * 0.5), (w * 0.82, h * 0.5)]
    face.arrow(points if rng.random() < 0.5 else points[::-1], "black", 0.05)
    face.legend = "arrow"
    return face
