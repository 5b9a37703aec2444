"""Faces that can be drawn into images: vector faces of many countries, cut-out real ones, invented boards, backs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.board_drawings import SHEETING, draw_board
from wayside.pipeline.learning.detector_images import BACK, FRONT
from wayside.schemas.detections import COLORS, NONE, SHAPES

BOARD_WEIGHTS = (0.17, 0.08, 0.25, 0.02, 0.08, 0.18, 0.15, 0.04, 0.03)
"""How often an invented board has each of these colours."""

KINDS = (("vector", 0.53), ("cut", 0.15), ("board", 0.18), ("crossbuck", 0.03), ("back", 0.11))
"""What is drawn, and how often."""


@dataclass(frozen=True, slots=True)
class FaceDrawing:
    """A face as pixels (h, w, 4) uint8 RGBA with its classes, `NONE` where they are none of ours."""

    rgba: NDArray[np.uint8]
    color: int
    shape: int


@dataclass(frozen=True, slots=True)
class FaceLibrary:
    """All faces that can be drawn: vector faces and cut-out real ones.

    A kind of face (a colour of a shape) of n drawings comes by their square root: some have hundreds, some one.
    """

    vector: tuple[FaceDrawing, ...]
    cut: tuple[FaceDrawing, ...]
    vector_share: NDArray[np.float64] = field(init=False)
    cut_share: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector_share", _shares(self.vector))
        object.__setattr__(self, "cut_share", _shares(self.cut))


def _shares(faces: Sequence[FaceDrawing]) -> NDArray[np.float64]:
    count = Counter((face.color, face.shape) for face in faces)
    share = np.array([count[face.color, face.shape] ** -0.5 for face in faces])
    return np.asarray(share / share.sum() if len(share) else share, np.float64)


def read_face_library(real: Path) -> FaceLibrary:
    """The vector faces and the cut-out real ones of a folder of real data."""
    index = json.loads((real / "faces" / "index.json").read_text(encoding="utf-8"))
    vector = []
    for entry in index:
        rgba = cv2.imread(str(real / "faces" / entry["png"]), cv2.IMREAD_UNCHANGED)
        if rgba is None or rgba.ndim != 3 or rgba.shape[2] != 4:
            continue
        pixels = np.asarray(cv2.cvtColor(rgba, cv2.COLOR_BGRA2RGBA), np.uint8)
        vector.append(FaceDrawing(pixels, _code(COLORS, entry["color"]), _shape_of(entry["shape"])))
    cut = []
    for entry in json.loads((real / "crops_gtsrb" / "crops.json").read_text(encoding="utf-8")):
        rgb = cv2.imread(str(real / "crops_gtsrb" / entry["file"]), cv2.IMREAD_COLOR_RGB)
        if rgb is not None:
            cut.append(_cut_out(np.asarray(rgb, np.uint8), entry))
    return FaceLibrary(tuple(vector), tuple(cut))


def _code(names: tuple[str, ...], name: str | None) -> int:
    return names.index(name) if name in names else NONE


def _shape_of(name: str | None) -> int:
    return _code(SHAPES, name)


def _cut_out(rgb: NDArray[np.uint8], entry: dict[str, object]) -> FaceDrawing:
    """A crop of GTSRB without its margin (a tenth of the sign, at least 5 px), masked by its outline."""
    height, width = rgb.shape[:2]
    margins = [max(5.0, side / 12) for side in (width, height)]
    box = np.array([margins[0], margins[1], width - margins[0], height - margins[1]])
    down = entry["class"] == 13
    outline = _outline(str(entry["shape"]), down=down)
    points = box[:2] + (outline + 1) / 2 * (box[2:] - box[:2])
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(points * 8).astype(np.int32)], 255, cv2.LINE_AA, 3)
    x0, y0, x1, y1 = np.round(box + np.array([-1, -1, 1, 1])).astype(int)
    rgba = np.dstack([rgb, mask])[max(y0, 0) : y1, max(x0, 0) : x1]
    return FaceDrawing(
        np.ascontiguousarray(rgba),
        _code(COLORS, str(entry["color"])),
        _shape_of(str(entry["shape"])),
    )


def _outline(shape: str, *, down: bool = False) -> NDArray[np.float64]:
    """Corners (n, 2) of a shape in -1 to 1."""
    if shape == "triangle":
        corners = np.array([[-0.93, 1], [-1, 0.88], [-0.07, -1], [0.07, -1], [1, 0.88], [0.93, 1]])
        return corners * [1, -1] if down else corners
    if shape == "diamond":
        return np.array([[0, -1.0], [1, 0], [0, 1], [-1, 0]])
    if shape == "octagon":
        t = np.tan(np.pi / 8)
        half = np.array([[-t, -1], [t, -1], [1, -t], [1, t]])
        return np.concatenate([half, -half])
    if shape == "circle":
        angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        return np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])


def chosen_face(
    kind: str, library: FaceLibrary, rng: np.random.Generator, color: int = NONE
) -> tuple[FaceDrawing, int]:
    """A face of a kind, boards in a colour if one is given, and the side of it that is seen."""
    if kind == "vector" and library.vector:
        face = library.vector[rng.choice(len(library.vector), p=library.vector_share)]
        return _recolored(face, rng), FRONT
    if kind == "cut" and library.cut:
        face = library.cut[rng.choice(len(library.cut), p=library.cut_share)]
        return (
            FaceDrawing(_relit(face.rgba, rng), face.color, face.shape),
            FRONT,
        )
    if kind == "back" and library.vector:
        face = library.vector[rng.choice(len(library.vector), p=library.vector_share)]
        rgba = face.rgba.copy()
        grey = rng.uniform(70, 190)
        rgba[..., :3] = np.clip(grey + rng.normal(0, 6, 3), 0, 255).astype(np.uint8)
        if rng.random() < 0.7:  # the post stands in front of the back
            middle, half = rgba.shape[1] // 2, max(2, int(rgba.shape[1] * rng.uniform(0.02, 0.06)))
            rgba[:, middle - half : middle + half, :3] = int(grey * rng.uniform(0.5, 0.9))
        return FaceDrawing(rgba, face.color, face.shape), BACK
    return _crossbuck(rng) if kind == "crossbuck" else _board(rng, color), FRONT


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


def _relit(rgba: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A cut-out face brought to a brightness in the middle: many are dark."""
    bright = float(np.percentile(rgba[..., :3].max(axis=2), 90))
    gain = np.clip(200 / max(bright, 20), 0.8, 4) * rng.uniform(0.7, 1.1)
    lit = rgba.copy()
    lit[..., :3] = np.clip(rgba[..., :3] * gain, 0, 255).astype(np.uint8)
    return lit


def _board(rng: np.random.Generator, code: int = NONE) -> FaceDrawing:
    """An invented board, in a colour if one is given."""
    color = str(rng.choice(list(SHEETING), p=BOARD_WEIGHTS)) if code == NONE else COLORS[code]
    return FaceDrawing(draw_board(color, rng), _code(COLORS, color), SHAPES.index("rectangle"))


def _crossbuck(rng: np.random.Generator) -> FaceDrawing:
    """The cross of a railway crossing: plain, with red ends or a coloured edge, or with words."""
    steep = np.radians(rng.uniform(28, 62))
    thick = rng.uniform(0.14, 0.24)
    along = np.array([np.cos(steep), np.sin(steep)])
    half = 128 / (along + thick / 2 * along[::-1]).max()
    side = np.ceil(2 * half * (along + thick / 2 * along[::-1])).astype(int) + 2
    pixels = np.empty((side[1], side[0], 3), np.uint8)
    pixels[:] = SHEETING["white"]
    alpha = np.zeros((side[1], side[0]), np.uint8)
    ends, has_words = rng.random() < 0.5, rng.random() < 0.5
    edge = SHEETING[str(rng.choice(["red", "black", "white"]))]
    for down in (1, -1):
        way = along * [1, down]
        across = np.array([-way[1], way[0]]) * thick / 2
        strip = np.array([-way - across, way - across, way + across, -way + across])
        corners = np.round((side - 1) / 2 + half * strip).astype(np.int32)
        cv2.fillPoly(alpha, [corners], 255, cv2.LINE_AA)
        cv2.fillPoly(pixels, [corners], SHEETING["white"], cv2.LINE_AA)
        cv2.polylines(pixels, [corners], True, edge, 2, cv2.LINE_AA)
        reach = rng.uniform(0.25, 0.5)
        for end in (-1, 1):
            inner = end * (1 - reach) * way
            part = np.array(
                [inner - across, end * way - across, end * way + across, inner + across]
            )
            place = np.round((side - 1) / 2 + half * part).astype(np.int32)
            if ends:
                cv2.fillPoly(pixels, [place], SHEETING["red"], cv2.LINE_AA)
            elif has_words:  # letters are no more than spots at the size of most views
                for share in (0.35, 0.55, 0.75):
                    spot = np.round((side - 1) / 2 + half * end * share * way).astype(int)
                    at = int(spot[0]), int(spot[1])
                    cv2.circle(pixels, at, max(1, round(half * thick / 5)), SHEETING["black"], 2)
    return FaceDrawing(np.dstack([pixels, alpha]), COLORS.index("white"), SHAPES.index("crossbuck"))
