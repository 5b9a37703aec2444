"""Stop, yield, speed limit and the other signs that order, of the United States."""

import cv2
import numpy as np

from recordings.drives.arrays import Bytes
from recordings.drives.signs.face import INCH, Face, bordered, fill_polygon, panel, pick
from recordings.drives.signs.shapes import Points

_WORDS = (
    *("DO NOT|PASS", "PASS|WITH|CARE", "KEEP|RIGHT", "NO|TURN ON|RED", "WEIGHT|LIMIT|10|TONS"),
    *("SLOWER|TRAFFIC|KEEP|RIGHT", "FINES|DOUBLED", "NO|DUMPING"),
)


def stop(rng: np.random.Generator) -> Face:
    """Stop octagon."""
    size = float(pick(rng, [30, 36])) * INCH
    face = bordered("stop", "red", "octagon", (size, size), "white", (0.022, 0.012))
    face.text("STOP", (size / 2, size / 2), size / 3, "white", size * 0.82)
    return face


def yield_sign(rng: np.random.Generator) -> Face:
    """Yield triangle, broad red band around white."""
    size = float(pick(rng, [36, 40])) * INCH
    face = Face("yield", "red", "triangle", size, size * 0.866, secondary=("white",))
    white = [(size * 0.29, size * 0.17), (size * 0.71, size * 0.17), (size * 0.5, size * 0.535)]
    face.fill(white, "white")
    face.text("YIELD", (size / 2, size * 0.235), size * 0.075, "red", size * 0.3)
    return face


def speed_limit(rng: np.random.Generator) -> Face:
    """Speed limit rectangle."""
    inches = pick(rng, [(24, 30), (30, 36), (24, 30)])
    w, h = inches[0] * INCH, inches[1] * INCH
    face = bordered("speed_limit", "white", "rectangle", (w, h), "black", (0.016, 0.012))
    face.text("SPEED", (w / 2, h * 0.17), h * 0.125, "black", w * 0.78)
    face.text("LIMIT", (w / 2, h * 0.345), h * 0.125, "black", w * 0.78)
    limit = str(pick(rng, [30, 45, 55, 65, 70]))
    face.text(limit, (w / 2, h * 0.68), h * 0.38, "black", w * 0.8, 0.2)
    return face


def regulatory_text(rng: np.random.Generator) -> Face:
    """White regulatory rectangle with words."""
    words = pick(rng, _WORDS)
    w, h = pick(rng, [(24, 30), (30, 36)])
    return panel("regulatory_text", "white", (w * INCH, h * INCH), "black", words.split("|"))


def no_parking(rng: np.random.Generator) -> Face:
    """White rectangle with red words."""
    face = panel("no_parking", "white", (12 * INCH, 18 * INCH), "red")
    face.lines(["NO", "PARKING", "ANY", "TIME"], "red", 0.05, 0.42)
    return face


def keep_right(rng: np.random.Generator) -> Face:
    """White rectangle with the keep-right symbol."""
    w, h = 24 * INCH, 30 * INCH
    face = panel("keep_right", "white", (w, h), "black")
    lane = [(w * 0.35, h * 0.85), (w * 0.35, h * 0.62), (w * 0.68, h * 0.42), (w * 0.68, h * 0.16)]
    face.arrow(lane, "black", 0.06)
    face.fill(
        [(w * 0.2, h * 0.2), (w * 0.42, h * 0.2), (w * 0.36, h * 0.5), (w * 0.2, h * 0.5)], "black"
    )
    return face


def do_not_enter(rng: np.random.Generator) -> Face:
    """White square, red disc, white bar."""
    s = 30 * INCH
    face = Face("do_not_enter", "red", "rectangle", s, s, secondary=("white",))
    face.fill(face.outlines[0], "white")
    face.disc(s / 2, s / 2, s * 0.47, "red")
    face.box(s * 0.15, s * 0.43, s * 0.85, s * 0.57, "white")
    face.text("DO NOT", (s / 2, s * 0.29), s * 0.11, "white", s * 0.5)
    face.text("ENTER", (s / 2, s * 0.71), s * 0.11, "white", s * 0.5)
    return face


def wrong_way(rng: np.random.Generator) -> Face:
    """Red rectangle."""
    return panel("wrong_way", "red", (36 * INCH, 24 * INCH), "white", ["WRONG", "WAY"])


def crossbuck(rng: np.random.Generator) -> Face:
    """Two white blades at right angles."""
    blade, thick = 48 * INCH, 9 * INCH
    size = (blade + thick) / np.sqrt(2)
    blades = [_blade(size, blade, thick, sign) for sign in (1, -1)]
    face = Face(
        "crossbuck", "white", "crossbuck", size, size, secondary=("black",), outlines=blades
    )
    lettered = []
    for angle, text in ((45, "RAILROAD"), (-45, "CROSSING")):
        layer = Face("text", "white", "rectangle", size, size)
        layer.text(text, (size / 2, size / 2), thick * 0.55, "black", blade * 0.82)
        rows, columns = layer.image.shape[:2]
        turn = cv2.getRotationMatrix2D((columns / 2, rows / 2), -angle, 1.0)
        lettered.append(
            cv2.warpAffine(layer.image, turn, (columns, rows), borderMode=cv2.BORDER_REPLICATE)
        )
    second: Bytes = np.zeros(face.image.shape[:2], np.uint8)
    fill_polygon(second, blades[1], 255)
    face.image[:] = np.where(second[..., None] > 127, lettered[1], lettered[0])
    face.legend = "RAILROAD CROSSING"
    return face


def _blade(size: float, length: float, thick: float, sign: int) -> Points:
    """Rectangle along a diagonal of a square panel."""
    centre = np.array([size / 2, size / 2])
    along = np.array([1.0, sign]) / np.sqrt(2)
    across = np.array([-along[1], along[0]])
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    points = (centre + along * a * length / 2 + across * b * thick / 2 for a, b in corners)
    return [(x, y) for x, y in points]


def tracks_plaque(rng: np.random.Generator) -> Face:
    """White number-of-tracks plaque."""
    count = str(pick(rng, [2, 3]))
    return panel("tracks_plaque", "white", (27 * INCH, 18 * INCH), "black", [count, "TRACKS"])
