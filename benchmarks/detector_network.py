"""Recall of a detection network against false boxes an image.

    OMP_NUM_THREADS=1 PYTHONPATH=. .venv/bin/python benchmarks/detector_network.py MODEL.onnx --sets SET [SET ...]

Sets: a rendered drive, a real drive with labels, or the start of the names in `scenes/scenes.json`. A face counts as
found by a box of IoU .5. False are boxes on no label and on nothing that is unknown; where images have faces without a
box (real drives), such a box may show one. The network's provenance says from which sets it has learned.
"""

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from common import DRIVES, REAL_DRIVES, print_table
from numpy.typing import NDArray

from training.detector_images import (
    FRONT,
    LabelledImage,
    real_drive_images,
    rendered_images,
    scene_set_images,
)
from wayside.stages.detection import DetectionNetwork, Part, boxes_of_maps
from wayside.stages.geometry import covered_fractions, iou_matrix

ON_FACE, NEAR_FACE = 0.5, 0.3
RATES = (0.2, 0.5, 1.0, 2.0)
"""False boxes an image at which recall is read off."""
HEIGHTS = ((15.0, 1e9), (10.0, 15.0))
LEAST_SCORE, MOST, SAME_IOU = -5.0, 60, 0.5

Boxes = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Boxes (n, 4) of an image and their scores (n,), above 0 where the network itself keeps them."""


def main() -> int:
    """Print the table."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("--sets", nargs="+", required=True)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    network = DetectionNetwork(str(given.model))
    rates = [f"at {rate:g}" for rate in RATES]
    heads = ("set", ">= 15 px", *rates, "own", "10-15 px", *rates, "own")
    print_table(heads, (set_row(name, network) for name in given.sets))
    return 0


def set_row(name: str, network: DetectionNetwork) -> list[str]:
    """Recall on a set by height, at each rate and at the network's own threshold."""
    images = images_of(name)
    found = list(boxes_of(network, images))
    judged = sum(image.complete[FRONT] for image in images) or len(images)
    false = np.sort(np.array(list(false_scores(images, found))))[::-1]
    cells = [name]
    for low, high in HEIGHTS:
        faces = np.array(list(face_scores(images, found, low, high)))
        cells.append(str(len(faces)))
        if not len(faces):
            cells += ["-"] * (len(RATES) + 1)
            continue
        for rate in RATES:
            allowed = int(rate * judged)
            threshold = false[allowed] if allowed < len(false) else -np.inf
            cells.append(f"{100 * (faces > threshold).mean():.0f}")
        cells.append(f"{100 * (faces > 0).mean():.0f} at {(false > 0).sum() / judged:.2f}")
    return cells


def images_of(name: str) -> list[LabelledImage]:
    """The images of a set, whole."""
    if (log := DRIVES / f"{name}.mcap").is_file():
        return list(rendered_images(log, 1, band=False))
    if (log := REAL_DRIVES / f"{name}.mcap").is_file():
        return list(real_drive_images(log, 1))
    return list(scene_set_images(REAL_DRIVES / "scenes", (name,)))


def boxes_of(network: DetectionNetwork, images: Sequence[LabelledImage]) -> Iterator[Boxes]:
    """What the network finds from the front."""
    for image in images:
        maps, size = network.maps(image.rgb), image.rgb.shape[:2]
        found = boxes_of_maps([Part(maps, size)], size, LEAST_SCORE, MOST, SAME_IOU)
        front = found.front == found.score
        yield found.box[front], found.score[front]


def face_scores(
    images: Sequence[LabelledImage], found: Sequence[Boxes], low: float, high: float
) -> Iterator[float]:
    """Scores at which the faces of heights from `low` to `high` are found."""
    for image, (box, score) in zip(images, found, strict=True):
        tall = image.box[:, 3] - image.box[:, 1]
        wanted = (image.side == FRONT) & (tall >= low) & (tall < high)
        for overlap in iou_matrix(image.box[wanted], box):
            yield float(score[overlap >= ON_FACE].max(initial=-np.inf))


def false_scores(images: Sequence[LabelledImage], found: Sequence[Boxes]) -> Iterator[float]:
    """Scores of the false boxes, of images with complete labels where there are any."""
    complete = any(image.complete[FRONT] for image in images)
    for image, (box, score) in zip(images, found, strict=True):
        if image.complete[FRONT] or not complete:
            near = iou_matrix(image.box, box).max(axis=0, initial=0) >= NEAR_FACE
            unknown = covered_fractions(box, image.ignored).max(axis=1, initial=0) >= 0.5
            yield from score[~near & ~unknown].tolist()


if __name__ == "__main__":
    sys.exit(main())
