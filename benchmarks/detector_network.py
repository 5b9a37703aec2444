r"""Recall of the detection network against false boxes an image, beside the detector of preset `default`.

    PYTHONPATH=. .venv/bin/python benchmarks/detector_network.py MODEL.onnx --sets ca_city_garmin jd curve \\
        [--real FOLDER] [--drives FOLDER] [--every N] [--cache FOLDER] [--cost]

Sets: a rendered drive (its log lies in the folder of drives), a real drive with labels, or the start of the names in
`scenes/scenes.json`. A face counts as found by a box of IoU .5. False are boxes on no label and on nothing that is
unknown; where images have faces without a box (real drives), such a box may show one. The boxes of the product are kept
in the cache, since they do not depend on the network. `both`: boxes of either, scores added where they overlap. The
detector that ships may have been learned from a set: the network's provenance says what it has seen, the product's
models say it in theirs.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from training.detector_images import (
    FRONT,
    LabelledImage,
    real_drive_images,
    rendered_images,
    scene_set_images,
)
from wayside.pipeline.flow import Flow
from wayside.pipeline.model_files import load_models
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.workers import StageClock
from wayside.schemas.frame import USED, Camera, Frame
from wayside.stages.detection import DetectionNetwork, boxes_of_maps
from wayside.stages.geometry import covered_fractions, iou_matrix

ROOT = Path(__file__).resolve().parents[1]
ON_FACE, NEAR_FACE = 0.5, 0.3
RATES = (0.2, 0.5, 1.0, 2.0)
"""False boxes an image at which recall is read off."""
HEIGHTS = ((10.0, 15.0), (15.0, 1e9))
LOWERED = 2.0
"""Log odds by which the product's threshold is lowered to draw its curve."""
LEAST_SCORE, MOST, SAME_IOU = -5.0, 60, 0.5
FOCAL_FRACTION = 0.9
"""Focal length of the unknown cameras of single images as a fraction of their longer side."""
ALL_ROWS = 9.0
"""Tangent above and below the optical axis beyond which no image reaches."""
ABSENT = (-3.0, -5.0)
"""Scores of product and network where one of them has no box."""


@dataclass(frozen=True, slots=True)
class Found:
    """Boxes (n, 4) of an image and their scores (n,), above 0 where the detector itself keeps them."""

    box: NDArray[np.float32]
    score: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Outcome:
    """Scores at which each face (n,) of one height class is found, and those of the false boxes (m,)."""

    faces: NDArray[np.float64]
    false: NDArray[np.float64]
    images: int

    def recall(self, rate: float) -> float:
        """Fraction of faces found at so many false boxes an image."""
        return self.above(self.threshold(rate))

    def threshold(self, rate: float) -> float:
        """The lowest threshold with at most so many false boxes an image."""
        allowed = int(rate * self.images)
        falling = np.sort(self.false)[::-1]
        return float(falling[allowed]) if allowed < len(falling) else -np.inf

    def above(self, threshold: float) -> float:
        """Fraction of faces found above a threshold."""
        return float((self.faces > threshold).mean()) if len(self.faces) else float("nan")


def images_of(name: str, real: Path, drives: Path, every: int) -> list[LabelledImage]:
    """The images of a set, whole."""
    if (drives / f"{name}.mcap").is_file():
        return list(rendered_images(drives / f"{name}.mcap", every, band=False))
    if (real / f"{name}.mcap").is_file():
        return list(real_drive_images(real / f"{name}.mcap", every))
    return list(scene_set_images(real / "scenes", (name,)))[::every]


def product_boxes(images: Sequence[LabelledImage]) -> Iterator[Found]:
    """What the detector of preset `default` keeps, and what it just does not.

    In single images, whose cameras are not known, it sees all rows: where the horizon lies in them, nothing says.
    """
    all_rows = {f"candidates.half_size_{side}": ALL_ROWS for side in ("above", "below")}
    settings, _ = load_settings("default", None, [], {} if images[0].camera else all_rows)
    models = load_models(settings)
    classifier = models.front_scores
    assert classifier is not None
    lowered = replace(classifier, threshold=classifier.threshold - LOWERED)
    flow = Flow(settings, replace(models, front_scores=lowered), StageClock())
    for item in flow.detect(_frames(images)):
        table = item.candidates
        rows = table.open_rows()
        yield Found(table.regions.box[rows], table.score[rows] - np.float32(classifier.threshold))


def _frames(images: Sequence[LabelledImage]) -> Iterator[Frame]:
    for index, image in enumerate(images):
        height, width = image.rgb.shape[:2]
        camera = image.camera
        if camera is None:
            focal = FOCAL_FRACTION * max(width, height)
            camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        yield Frame(index, index, None, USED, "rgb8", image.rgb.tobytes(), camera, width, height)


def network_boxes(network: DetectionNetwork, images: Sequence[LabelledImage]) -> Iterator[Found]:
    """What the network finds from the front."""
    for image in images:
        found = boxes_of_maps(
            network.maps(image.rgb), image.rgb.shape[:2], LEAST_SCORE, MOST, SAME_IOU
        )
        front = found.front == found.score
        yield Found(found.box[front], found.score[front])


def both(product: Found, network: Found) -> Found:
    """Boxes of either detector, scores added; of two that overlap that of the product stays."""
    overlap = iou_matrix(product.box, network.box)
    paired = overlap.max(axis=1, initial=0) >= ON_FACE
    nearest = overlap.argmax(axis=1) if overlap.size else np.zeros(len(product.box), np.int64)
    other = np.where(paired, network.score[nearest], ABSENT[1]) if overlap.size else ABSENT[1]
    alone = overlap.max(axis=0, initial=0) < ON_FACE
    return Found(
        np.concatenate([product.box, network.box[alone]]),
        np.concatenate([product.score + other, network.score[alone] + ABSENT[0]]),
    )


def outcome(
    images: Sequence[LabelledImage], found: Sequence[Found], low: float, high: float
) -> Outcome:
    """Faces of heights from `low` to `high`, and all false boxes of the images where they can be told."""
    faces: list[float] = []
    false: list[float] = []
    judged = [i for i in images if i.fronts_complete] or images
    for image, own in zip(images, found, strict=True):
        front = image.side == FRONT
        tall = image.box[:, 3] - image.box[:, 1]
        overlap = iou_matrix(image.box, own.box)
        for row in np.flatnonzero(front & (tall >= low) & (tall < high)):
            on = overlap[row] >= ON_FACE
            faces.append(float(own.score[on].max()) if on.any() else -np.inf)
        if any(image is one for one in judged):
            near = overlap.max(axis=0, initial=0) >= NEAR_FACE
            unknown = covered_fractions(own.box, image.ignored).max(axis=1, initial=0) >= 0.5
            false += own.score[~near & ~unknown].tolist()
    return Outcome(np.array(faces), np.array(false), len(judged))


def row(name: str, what: str, images: Sequence[LabelledImage], found: Sequence[Found]) -> str:
    """A line of the table: recall by height at each rate, and at the detector's own threshold."""
    cells = []
    for low, high in HEIGHTS[::-1]:
        one = outcome(images, found, low, high)
        cells += [str(len(one.faces)), *(f"{100 * one.recall(rate):.0f}" for rate in RATES)]
        own_rate = float((one.false > 0).sum() / max(one.images, 1))
        cells.append(f"{100 * one.above(0):.0f} at {own_rate:.2f}")
    return f"| {name} | {what} | " + " | ".join(cells) + " |"


def cost_lines(network: DetectionNetwork, images: Sequence[LabelledImage]) -> Iterator[str]:
    """Milliseconds of the network on whole images, beside a decode of the same image as JPEG."""
    image = images[len(images) // 2].rgb
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])
    calls = {
        "decode": lambda: cv2.imdecode(data, cv2.IMREAD_COLOR),
        "network": lambda: network.maps(image),
    }
    seconds = {}
    for name, call in calls.items():
        call()
        times = []
        for _ in range(7):
            start = time.thread_time()
            call()
            times.append(time.thread_time() - start)
        seconds[name] = min(times)
    height, width = image.shape[:2]
    decodes = seconds["network"] / seconds["decode"]
    yield (
        f"{width} x {height}: decode {1e3 * seconds['decode']:.1f} ms, "
        f"network {1e3 * seconds['network']:.1f} ms, {decodes:.1f} decodes"
    )


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("--sets", nargs="+", required=True)
    parser.add_argument("--real", type=Path, default=ROOT.parent / "shared" / "data" / "real")
    parser.add_argument("--drives", type=Path, default=ROOT / ".cache" / "drives")
    parser.add_argument("--every", type=int, default=1, help="every n-th image only")
    parser.add_argument("--cache", type=Path, default=ROOT / ".cache" / "product_boxes")
    parser.add_argument("--cost", action="store_true")
    parser.add_argument("--no-product", action="store_true")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    args.cache.mkdir(parents=True, exist_ok=True)
    network = DetectionNetwork(str(args.model))
    rates = [f"at {rate:g}" for rate in RATES]
    heads = ["set", "detector", ">= 15 px", *rates, "own", "10-15 px", *rates, "own"]
    print("| " + " | ".join(heads) + " |\n|" + " --- |" * len(heads))
    for name in args.sets:
        images = images_of(name, args.real, args.drives, args.every)
        ours = list(network_boxes(network, images))
        print(row(name, "network", images, ours), flush=True)
        if not args.no_product:
            theirs = cached_product_boxes(args.cache / f"{name}_{args.every}.npz", images)
            print(row(name, "product", images, theirs))
            joined = [both(p, n) for p, n in zip(theirs, ours, strict=True)]
            print(row(name, "both", images, joined), flush=True)
        if args.cost:
            print(*cost_lines(network, images), sep="\n", file=sys.stderr)
    return 0


def cached_product_boxes(path: Path, images: Sequence[LabelledImage]) -> list[Found]:
    """The product's boxes, from the file if it is there."""
    if not path.is_file():
        found = list(product_boxes(images))
        count = np.array([len(one.box) for one in found])
        np.savez(
            path,
            box=np.concatenate([one.box for one in found]),
            score=np.concatenate([one.score for one in found]),
            count=count,
        )
    with np.load(path) as held:
        cuts = np.cumsum(held["count"])[:-1]
        parts = zip(np.split(held["box"], cuts), np.split(held["score"], cuts), strict=True)
        return [Found(box, score) for box, score in parts]


if __name__ == "__main__":
    sys.exit(main())
