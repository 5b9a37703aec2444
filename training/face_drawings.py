"""Faces that can be drawn into images: vector faces of many countries, cut-out real ones, boards, backs."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from recordings.drives.signs.face import COLORS as SHEETING
from recordings.drives.signs.face import Face, pick
from recordings.drives.signs.regulatory import crossbuck
from recordings.drives.signs.shapes import outline
from recordings.drives.signs.symbols import SYMBOL_NAMES, draw_symbol
from training.detector_images import BACK, FRONT
from wayside.schemas.detections import LEARNED_COLORS as COLORS
from wayside.schemas.detections import NONE, SHAPES
from wayside.stages.kernels import Array, Bytes

BOARD_WEIGHTS = {
    "white": 0.17,
    "yellow": 0.08,
    "green": 0.25,
    "red": 0.02,
    "orange": 0.08,
    "blue": 0.18,
    "brown": 0.15,
    "fluorescent_yellow_green": 0.04,
    "black": 0.03,
}
"""How often an invented board has each colour."""

LIGHT = ("white", "yellow", "orange", "fluorescent_yellow_green")
"""Those with dark letters."""

WORDS = (
    "EXIT|NORTH|Madrid|A 96|City|Main St|Park|1/2 MILE|ONE WAY|Ausfahrt|LANE|ONLY|Hospital|Centre|280|BUS|P|12 km|Lake"
    "|ROAD WORK"
).split("|")

LETTERS = "abcdefghijklmnopqrstuvwxyz"

ASPECTS, LONGEST_M = (0.45, 4.8), 0.64
"""Width over height, log-uniform; longer side, or less: 256 pixels."""

MOST_LINES = 6

EDGE, ARROW, SYMBOL, INSERT = 0.75, 0.4, 0.3, 0.2
"""How often a board has an edge, an arrow, a symbol, and a panel of another colour behind one of its lines."""

GROUND_SIGMA = 12.0
"""Scatter of the colours of a board, levels."""


def draw_board(color: str, rng: np.random.Generator) -> Bytes:
    """A board (h, w, 4), RGBA, whose ground has a colour of `BOARD_WEIGHTS`."""
    aspect = float(np.exp(rng.uniform(*np.log(ASPECTS))))
    width = LONGEST_M if aspect >= 1 else max(0.2, LONGEST_M * aspect)
    face = Face("board", color, "rectangle", width, max(0.12, width / aspect))
    ink = edge_ink = _ink_on(color)
    if color == "white":
        choices = ["black", "red", "blue", "green"]
        ink, edge_ink = (str(one) for one in rng.choice(choices, 2, p=[0.6, 0.1, 0.2, 0.1]))
    margin = 0.0
    if rng.random() < EDGE:
        thick, inset = face.height * rng.uniform(0.02, 0.06), rng.integers(0, 2)
        face.border(edge_ink, thick, thick * inset)
        margin = thick * (1 + inset)
    left, right = margin + 0.02 * face.width, 0.98 * face.width - margin
    for share, is_arrow in ((ARROW, True), (SYMBOL, False)):
        side = min(0.8 * face.height, 0.45 * (right - left))
        if rng.random() < share and side > 0.03:
            at_left = rng.random() < 0.5
            middle = left + side / 2 if at_left else right - side / 2
            (_draw_arrow if is_arrow else _draw_symbol)(face, middle, side, ink, rng)
            left, right = (left + side, right) if at_left else (left, right - side)
    _draw_lines(face, (left, right), 0.9 * face.height - 2 * margin, ink, rng)
    rgb = np.clip(face.image + rng.normal(0, GROUND_SIGMA, 3), 0, 255).astype(np.uint8)
    return np.dstack([rgb, face.alpha()])


def _ink_on(color: str) -> str:
    """Letters on a ground are black or white."""
    return "black" if color in LIGHT else "white"


def _draw_arrow(face: Face, middle: float, side: float, ink: str, rng: np.random.Generator) -> None:
    """An arrow in one of eight directions, in a square half-way up."""
    turn = np.pi / 4 * rng.choice([0, 2, 6, 1, 7, 3, 5, 4], p=[0.4, 0.15, 0.15, *[0.06] * 5])
    way = side * 0.4 * np.array([np.sin(turn), -np.cos(turn)])
    centre = np.array([middle, face.height / 2])
    ends = [(float(x), float(y)) for x, y in (centre - way, centre + way)]
    face.arrow(ends, ink, side * rng.uniform(0.08, 0.2))


def _draw_symbol(
    face: Face, middle: float, side: float, ink: str, rng: np.random.Generator
) -> None:
    """A symbol on a square half-way up; now and then in the colour of the ground, framed by the ink."""
    ground = face.color
    if rng.random() < 0.4:
        ink, ground = ground, ink
    plate = Face("symbol", ground, "rectangle", side, side)
    draw_symbol(plate, pick(rng, SYMBOL_NAMES), ink)
    rows, columns = plate.image.shape[:2]
    y, x = (face.image.shape[0] - rows) // 2, round(middle / face.width * face.image.shape[1])
    x = int(np.clip(x - columns // 2, 0, face.image.shape[1] - columns))
    face.image[y : y + rows, x : x + columns] = plate.image


def _draw_lines(
    face: Face, between: tuple[float, float], tall: float, ink: str, rng: np.random.Generator
) -> None:
    """Lines of words between two columns, one of them at times on a panel of another colour; tall: all together."""
    left, right = between
    lines = min(int(rng.integers(1, MOST_LINES + 1)), max(1, round(3 * tall / (right - left))))
    inserted = int(rng.integers(lines)) if lines > 1 and rng.random() < INSERT else -1
    pitch, size = tall / lines, rng.uniform(0.36, 0.62)
    for line in range(lines):
        middle, letters = (face.height - tall) / 2 + (line + 0.5) * pitch, ink
        if line == inserted:
            ground = pick(rng, list(BOARD_WEIGHTS))
            letters = _ink_on(ground)
            end = left + (right - left) * rng.uniform(0.6, 1)
            face.box(left, middle - pitch / 2, end, middle + pitch / 2, ground)
        centre = (left + right) / 2 + rng.uniform(-0.06, 0.06) * (right - left), middle
        room, weight = 0.85 * (right - left), rng.uniform(0.1, 0.24)
        face.text(some_words(rng), centre, pitch * size, letters, room, weight)


def some_words(rng: np.random.Generator) -> str:
    """A word or two, or a number."""
    kind = rng.random()
    if kind < 0.4:
        return pick(rng, WORDS)
    if kind < 0.5:
        return str(rng.integers(1, 999))
    word = "".join(rng.choice(list(LETTERS), int(rng.integers(3, 12))))
    return word.upper() if rng.random() < 0.4 else word.capitalize()


GIVE_WAY = 13
"""Class of GTSRB whose triangle points down."""

KINDS = (("vector", 0.53), ("cut", 0.15), ("board", 0.18), ("crossbuck", 0.03), ("back", 0.11))
"""What is drawn, and how often."""


@dataclass(frozen=True, slots=True)
class FaceDrawing:
    """A face as pixels (h, w, 4) uint8 RGBA with its classes, `NONE` where they are none of ours, and the side seen."""

    rgba: Bytes
    color: int
    shape: int
    side: int = FRONT


@dataclass(frozen=True, slots=True)
class FaceLibrary:
    """All faces that can be drawn: vector faces and cut-out real ones.

    A kind of face (a colour of a shape) of n drawings comes by their square root: some have hundreds, some one.
    """

    vector: tuple[FaceDrawing, ...]
    cut: tuple[FaceDrawing, ...]
    vector_share: Array = field(init=False)
    cut_share: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector_share", _shares(self.vector))
        object.__setattr__(self, "cut_share", _shares(self.cut))


def _shares(faces: Sequence[FaceDrawing]) -> Array:
    count = Counter((face.color, face.shape) for face in faces)
    share = np.array([count[face.color, face.shape] ** -0.5 for face in faces])
    return np.asarray(share / share.sum() if len(share) else share, np.float64)


def vector_faces(real: Path) -> Iterator[tuple[dict[str, Any], Bytes]]:
    """The vector faces of a folder of real data: the entry of each, and its pixels (h, w, 4), RGBA."""
    for entry in json.loads((real / "faces" / "index.json").read_text(encoding="utf-8")):
        bgra = cv2.imread(str(real / "faces" / entry["png"]), cv2.IMREAD_UNCHANGED)
        if bgra is not None and bgra.ndim == 3 and bgra.shape[2] == 4:
            yield entry, np.asarray(cv2.cvtColor(bgra, cv2.COLOR_BGRA2RGBA), np.uint8)


def face_crops(
    real: Path,
) -> Iterator[tuple[dict[str, Any], Bytes, Array]]:
    """The crops of GTSRB in a folder of real data: the entry of each, pixels (h, w, 3), and box of the face."""
    for entry in json.loads((real / "crops_gtsrb" / "crops.json").read_text(encoding="utf-8")):
        rgb = cv2.imread(str(real / "crops_gtsrb" / entry["file"]), cv2.IMREAD_COLOR_RGB)
        if rgb is not None:
            size = np.array(rgb.shape[1::-1])
            # the source leaves a tenth of the sign around it, at least 5 px
            margins = np.maximum(5.0, size / 12)
            yield entry, np.asarray(rgb, np.uint8), np.concatenate([margins, size - margins])


def read_face_library(real: Path) -> FaceLibrary:
    """The vector faces and the cut-out real ones of a folder of real data."""
    return FaceLibrary(
        tuple(_classed(rgba, entry) for entry, rgba in vector_faces(real)),
        tuple(_cut_out(*crop) for crop in face_crops(real)),
    )


def _classed(rgba: Bytes, entry: dict[str, Any]) -> FaceDrawing:
    color, shape = (
        names.index(entry[key]) if entry[key] in names else NONE
        for key, names in (("color", COLORS), ("shape", SHAPES))
    )
    return FaceDrawing(rgba, color, shape)


def _cut_out(entry: dict[str, Any], rgb: Bytes, box: Array) -> FaceDrawing:
    """A crop of GTSRB without its margin, masked by the outline of its shape."""
    upward = entry["shape"] == "triangle" and entry["class"] != GIVE_WAY
    shape = "triangle_up" if upward else entry["shape"]
    points = box[:2] + np.array(outline(shape, *(box[2:] - box[:2])))
    mask = np.zeros(rgb.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.round(points * 8).astype(np.int32)], 255, cv2.LINE_AA, 3)
    x0, y0, x1, y1 = np.round(box + np.array([-1, -1, 1, 1])).astype(int)
    rgba = np.dstack([rgb, mask])[max(y0, 0) : y1, max(x0, 0) : x1]
    return _classed(np.ascontiguousarray(rgba), entry)


def chosen_face(
    kind: str, library: FaceLibrary, rng: np.random.Generator, color: int = NONE
) -> FaceDrawing:
    """A face of a kind, boards in a colour if one is given."""
    if kind == "vector" and library.vector:
        face = library.vector[rng.choice(len(library.vector), p=library.vector_share)]
        return _recolored(face, rng)
    if kind == "cut" and library.cut:
        face = library.cut[rng.choice(len(library.cut), p=library.cut_share)]
        return FaceDrawing(_relit(face.rgba, rng), face.color, face.shape)
    if kind == "back" and library.vector:
        face = library.vector[rng.choice(len(library.vector), p=library.vector_share)]
        rgba = face.rgba.copy()
        grey = rng.uniform(70, 190)
        rgba[..., :3] = np.clip(grey + rng.normal(0, 6, 3), 0, 255).astype(np.uint8)
        if rng.random() < 0.7:  # the post stands in front of the back
            middle, half = rgba.shape[1] // 2, max(2, int(rgba.shape[1] * rng.uniform(0.02, 0.06)))
            rgba[:, middle - half : middle + half, :3] = int(grey * rng.uniform(0.5, 0.9))
        return FaceDrawing(rgba, face.color, face.shape, BACK)
    return _crossbuck(rng) if kind == "crossbuck" else _board(rng, color)


def _recolored(face: FaceDrawing, rng: np.random.Generator) -> FaceDrawing:
    """Now and then a yellow face as an orange or a fluorescent one."""
    if face.color != COLORS.index("yellow") or rng.random() > 0.3:
        return face
    name = str(rng.choice(["orange", "fluorescent_yellow_green"]))
    rgb = face.rgba[..., :3].astype(np.int16)
    is_yellow = (rgb[..., 0] > 150) & (rgb[..., 1] > 110) & (rgb[..., 2] < 120)
    rgba = face.rgba.copy()
    rgba[is_yellow, :3] = SHEETING[name]
    return FaceDrawing(rgba, COLORS.index(name), face.shape)


def _relit(rgba: Bytes, rng: np.random.Generator) -> Bytes:
    """A cut-out face brought to a brightness in the middle: many are dark."""
    bright = float(np.percentile(rgba[..., :3].max(axis=2), 90))
    gain = np.clip(200 / max(bright, 20), 0.8, 4) * rng.uniform(0.7, 1.1)
    lit = rgba.copy()
    lit[..., :3] = np.clip(rgba[..., :3] * gain, 0, 255).astype(np.uint8)
    return lit


def _board(rng: np.random.Generator, code: int = NONE) -> FaceDrawing:
    """An invented board, in a colour if one is given."""
    weights = BOARD_WEIGHTS
    color = COLORS[code] if code != NONE else str(rng.choice([*weights], p=[*weights.values()]))
    known = COLORS.index(color) if color in COLORS else NONE
    return FaceDrawing(draw_board(color, rng), known, SHAPES.index("rectangle"))


def _crossbuck(rng: np.random.Generator) -> FaceDrawing:
    """The cross of a railway crossing, steep or flat, with words or with red ends."""
    face = crossbuck(rng)
    rgba = np.dstack([face.image, face.alpha()])
    if rng.random() < 0.5:
        reach = round(rng.uniform(0.15, 0.3) * len(rgba))
        rgba[reach:-reach, :, :3] = SHEETING["white"]
        rgba[:reach, :, :3] = rgba[-reach:, :, :3] = SHEETING["red"]
    steep = np.tan(np.radians(rng.uniform(28, 62)))
    size = np.round(256 * np.array([1.0, steep]) / max(1.0, steep)).astype(int)
    scaled = np.asarray(cv2.resize(rgba, size.tolist(), interpolation=cv2.INTER_AREA), np.uint8)
    return FaceDrawing(scaled, COLORS.index("white"), SHAPES.index("crossbuck"))
