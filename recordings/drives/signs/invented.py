"""Faces that no catalogue holds, so that what is learned is what a sign is and not a list of signs."""

import numpy as np

from recordings.drives.signs.face import COLORS, Face, pick
from recordings.drives.signs.symbols import SYMBOL_NAMES, draw_symbol

_GROUNDS = (
    *("white", "white", "yellow", "green", "red", "orange", "blue", "blue", "brown"),
    "fluorescent_yellow_green",
)
_ON_LIGHT = ("black", "black", "red", "blue", "green")
_ON_DARK = ("white", "white", "white", "yellow")
_LIGHT = ("white", "yellow", "orange", "fluorescent_yellow_green")
_SHAPES = (
    *("rectangle",) * 7,
    *("circle", "circle", "diamond", "triangle_up", "triangle", "octagon", "pentagon", "shield"),
)
_LETTERS = "ABCDEFGHIKLMNOPRSTUVWZ0123456789"


def invented(rng: np.random.Generator) -> Face:
    """A face of any shape, colours, border and content that road users could read."""
    while True:
        face = _drawn(rng)
        parts = _parts(face)
        if parts[0] in _GROUNDS:
            face.color, face.secondary = parts[0], tuple(parts[1:])
            face.legend = "invented"
            return face


def _drawn(rng: np.random.Generator) -> Face:
    shape = pick(rng, _SHAPES)
    ground = pick(rng, _GROUNDS)
    inks = [ink for ink in (_ON_LIGHT if ground in _LIGHT else _ON_DARK) if ink != ground]
    ink = pick(rng, inks)
    width = float(rng.uniform(0.4, 1.1))
    height = width
    if shape == "rectangle":
        height = float(np.clip(width * np.exp(rng.normal(0, 0.55)), 0.3, 1.5))
    elif shape == "triangle_up":
        height = width * 0.866
    face = Face("invented", ground, shape, width, height)
    content = pick(rng, (_text, _text, _symbol, _stripes, _halves, _arrow, _text_or_nothing))
    content(face, ink, rng)
    if rng.random() < 0.75:
        small = min(width, height)
        thick = small * float(pick(rng, (0.025, 0.04, 0.08, 0.12)))
        face.border(pick(rng, inks), thick, small * float(pick(rng, (0.0, 0.0, 0.02))))
    if rng.random() < 0.12:
        bar = pick(rng, inks)
        face.line([(0.1 * width, 0.9 * height), (0.9 * width, 0.1 * height)], bar, 0.05 * width)
    return face


def _parts(face: Face) -> list[str]:
    """Colours of the face that cover a twentieth of it or more, the largest first."""
    pixels = face.image[face.alpha() > 127][::5].astype(np.int64)
    sheeting = np.array(list(COLORS.values()))
    nearest = ((pixels[:, None] - sheeting) ** 2).sum(axis=2).argmin(axis=1)
    share = np.bincount(nearest, minlength=len(COLORS)) / len(pixels)
    names = list(COLORS)
    return [names[k] for k in np.argsort(-share, kind="stable") if share[k] >= 0.05]


def _word(rng: np.random.Generator) -> str:
    return "".join(pick(rng, _LETTERS) for _ in range(int(rng.integers(2, 9))))


def _text(face: Face, ink: str, rng: np.random.Generator) -> None:
    lines = [_word(rng) for _ in range(int(rng.integers(1, 4)))]
    top = 0.28 if face.shape.startswith("triangle") or face.shape == "diamond" else 0.15
    face.lines(lines, ink, face.height * top, face.height * (1 - top))


def _symbol(face: Face, ink: str, rng: np.random.Generator) -> None:
    if face.height < 0.8 * face.width:
        _text(face, ink, rng)
    else:
        draw_symbol(face, pick(rng, SYMBOL_NAMES), ink)


def _stripes(face: Face, ink: str, rng: np.random.Generator) -> None:
    count = int(rng.integers(1, 5))
    rise = face.height * float(rng.uniform(-0.35, 0.35))
    pitch = face.height / (count + rng.uniform(0.2, 1.0))
    for k in range(count):
        y = face.height / 2 + pitch * (k - (count - 1) / 2)
        left, right, half = y + rise / 2, y - rise / 2, pitch * 0.24
        corners = [(0.0, left - half), (face.width, right - half)]
        face.fill([*corners, (face.width, right + half), (0.0, left + half)], ink)


def _halves(face: Face, ink: str, rng: np.random.Generator) -> None:
    split = face.height * float(rng.uniform(0.25, 0.45))
    face.box(0, 0, face.width, split, ink)
    room = face.width * 0.6
    face.text(_word(rng), (face.width / 2, (split + face.height) / 2), split * 0.6, ink, room)


def _arrow(face: Face, ink: str, rng: np.random.Generator) -> None:
    width, height = face.width, face.height
    ends = pick(
        rng, [((0.5, 0.78), (0.5, 0.3)), ((0.25, 0.55), (0.72, 0.55)), ((0.75, 0.55), (0.28, 0.55))]
    )
    face.arrow([(width * x, height * y) for x, y in ends], ink, 0.1 * min(width, height))


def _text_or_nothing(face: Face, ink: str, rng: np.random.Generator) -> None:
    """Every other one stays bare, as faces in hard light or with worn print look."""
    if rng.random() < 0.5:
        _text(face, ink, rng)
