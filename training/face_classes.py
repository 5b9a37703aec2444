"""Which class of the face classifier a drawing or a real crop of a sign shows.

A class is named by its code, and by its legend where faces of one code differ by it: `R2-1 45`, `W1-2 left`, `C14 50`.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from training.face_drawings import face_crops, vector_faces
from wayside.stages.sign_codes import OTHER_FACE, face_patch

GTSRB = (
    *("C14 20", "C14 30", "C14 50", "C14 60", "C14 70", "C14 80", "C17b 80", "C14 100", "C14 120"),
    *("C13a", "C13b", "A19", "B3", "B1", "stop", "C2", "C3e", "C1", "A32", "A1a", "A1b", "A1c"),
    *("A7", "A9", "A4 right", "A16", "A17", "A12", "A13", "A14", "A ice", "A15b", "C17a"),
    *("D1 right", "D1 left", "D1 straight", "D1 straight or right", "D1 straight or left"),
    *("D2 right", "D2 left", "D3", "C17c", "C17d"),
)
"""Class of each of the 43 numbers of GTSRB (Stallkamp et al. 2012), by the codes of the Vienna Convention, annex 1."""

DRAWN = {
    ("yield", "white"): "B1",
    ("stop", "red"): "stop",
    ("priority road", "yellow"): "B3",
    ("no entry", "red"): "C1",
    ("no overtaking", "white"): "C13a",
    ("no overtaking by heavy goods vehicles", "white"): "C13b",
    ("road closed to vehicles", "white"): "C2",
    ("no heavy goods vehicles", "white"): "C3e",
    ("end of prohibition", "white"): "C17a",
    ("end of no overtaking", "white"): "C17c",
    ("end of no overtaking by heavy goods vehicles", "white"): "C17d",
    ("other danger", "white"): "A32",
    ("curve left", "white"): "A1a",
    ("curve right", "white"): "A1b",
    ("double curve first left", "white"): "A1c",
    ("uneven road", "white"): "A7",
    ("slippery road surface", "white"): "A9",
    ("road narrows right", "white"): "A4 right",
    ("roadworks", "white"): "A16",
    ("traffic signals", "white"): "A17",
    ("pedestrians crossing", "white"): "A12",
    ("children", "white"): "A13",
    ("bicycles crossing", "white"): "A14",
    ("icy road", "white"): "A ice",
    ("wild animals", "white"): "A15b",
    ("turn right ahead", "blue"): "D1 right",
    ("turn left ahead", "blue"): "D1 left",
    ("go straight", "blue"): "D1 straight",
    ("go straight or turn right", "blue"): "D1 straight or right",
    ("go straight or turn left", "blue"): "D1 straight or left",
    ("keep right", "blue"): "D2 right",
    ("keep left", "blue"): "D2 left",
    ("roundabout", "blue"): "D3",
    ("pedestrians crossing", "blue"): "E12",
    ("parking", "blue"): "E14",
}
"""Class of drawings by their meaning and colour, of the shape that the code has."""

_US_MEANINGS = (
    *("turn", "curve", "reverse", "winding", "crossroads", "side road", "t roads", "y roads"),
    *("stop ahead", "yield ahead", "signals", "bicycles", "pedestrians", "dead end", "roadworks"),
    *("construction", "one way", "keep right", "do not pass", "pass right", "road closed", "stop"),
    *("no right turn", "no left turn", "no u turn", "lane", "no parking", "priority road"),
    *("horizontal alignment", "chevron", "go left", "go right", "interstate", "school", "texts"),
    *("maximum speed", "speed limit", "hairpin", "no turns", "street name", "exit", "no motor"),
)
"""Drawings of other countries in US form may show a class of ours by another name: those teach nothing."""

TAUGHT, VALIDATED, TESTED = (0, 1, 2, 3, 4), (5,), (6, 7, 8)
"""Tracks of GTSRB, numbered by a checksum modulo 9: which teach, which choose the temperature, which are measured."""


@dataclass(frozen=True, slots=True)
class FaceExample:
    """A face and its class: a drawing as RGBA uint8 `(h, w, 4)`, or a crop `(h, w, 3)` with the box of its face."""

    name: str
    pixels: NDArray[np.uint8]
    box: NDArray[np.float64]


def drawings(real: Path) -> Iterator[FaceExample]:
    """The vector faces of a folder of real data, each with its class; those of no class are `OTHER_FACE`."""
    for entry, rgba in vector_faces(real):
        name = class_of_drawing(entry)
        if name is not None:
            yield FaceExample(name, rgba, np.array([0.0, 0, rgba.shape[1], rgba.shape[0]]))


def class_of_drawing(entry: dict[str, Any]) -> str | None:
    """Class of a drawing; None where it may be of a class by another name."""
    kind, color, shape = str(entry["kind"]), entry["color"], entry["shape"]
    if "code" in entry:
        return us_class(str(entry["code"]), entry.get("props", {}))
    limit = re.fullmatch(r"maximum speed limit (\d+)", kind)
    if limit and shape == "circle":
        return f"C14 {limit[1]}"
    if limit and shape == "rectangle" and color == "white" and int(limit[1]) in range(15, 80, 5):
        return f"R2-1 {limit[1]}"
    ended = re.fullmatch(r"end of maximum speed limit (\d+)", kind)
    if ended:
        return f"C17b {ended[1]}" if ended[1] == "80" else OTHER_FACE
    named = DRAWN.get((kind, str(color)))
    if named is not None:
        first = named[0]
        shapes = {"A": "triangle", "C": "circle", "D": "circle", "E": "rectangle", "s": "octagon"}
        wanted = {"B1": "triangle", "B3": "diamond"}.get(named, shapes.get(first))
        return named if shape == wanted else None
    us_form = shape in ("diamond", "rectangle", "shield", "pentagon")
    if us_form and any(words in kind for words in _US_MEANINGS):
        return None
    return OTHER_FACE


def us_class(code: str, props: dict[str, Any]) -> str:
    """Class of a US face: its code, with the number or the direction that it shows."""
    if code == "R1-1":
        return "stop"
    legend = props.get("speed", props.get("direction", props.get("movement")))
    return code if legend is None else f"{code} {legend}"


def crops(real: Path, tracks: tuple[int, ...]) -> Iterator[FaceExample]:
    """The crops of GTSRB whose track has one of these numbers, with the box of the face in them."""
    for entry, rgb, box in face_crops(real):
        if crc32(str(entry["track"]).encode()) % 9 in tracks:
            yield FaceExample(GTSRB[int(entry["class"])], rgb, box)


def still_patches(examples: Iterable[FaceExample]) -> tuple[NDArray[np.uint8], NDArray[np.str_]]:
    """The patches of examples as they are, and their classes."""
    listed = list(examples)
    patches = np.stack([face_patch(one.pixels, one.box) for one in listed])
    return patches, np.array([one.name for one in listed])
