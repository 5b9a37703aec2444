"""Learning of the face classifier: `python -m training.face_codes --real FOLDER -o MODELS`.

It is taught by vector drawings, seen from an angle, worn, before real backgrounds and through other cameras, and by
real crops. Whole tracks of those choose its temperature, and other whole tracks measure it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from training.camera_effects import Noise, make_noise, through_a_camera
from training.detector_images import FRONT
from training.face_classes import (
    TAUGHT,
    TESTED,
    VALIDATED,
    FaceExample,
    crops,
    drawings,
    still_patches,
)
from training.face_compositing import BRIGHTNESS, blend, seen_from_an_angle, wear
from training.face_drawings import FaceDrawing, FaceLibrary, chosen_face
from training.face_network import at_temperature, export, fit
from training.learn import images, run
from wayside.schemas.detections import NONE
from wayside.stages.sign_codes import OTHER_FACE, face_patch

FILE = "face_code.onnx"

BACKGROUNDS = ("us_freeway_challenge", "us_freeway_white_right")
"""Real drives (MIT) before whose images the drawings are put."""

DRAWN, DRAWN_OTHER, CROPPED = 300, 9_000, 16
"""Patches of each drawn class, of all other faces together, and copies of each real crop."""

HEIGHTS_PX = (11.0, 80.0)
"""Heights of drawn faces, log-uniform."""

BOX_SIGMA, BOX_SIGMA_PX = 0.025, 0.5
"""Scatter of the sides of a face's box: as a fraction of its size, and in pixels."""

Patches = tuple[NDArray[np.uint8], NDArray[np.str_]]


def learn_face_codes(real: Path, seed: int, out: Path) -> None:
    """Write the face classifier."""
    rng = np.random.default_rng(seed)
    noise = make_noise(rng)
    drawn, taught = list(drawings(real)), list(crops(real, TAUGHT))
    patches, names = drawn_patches(drawn, _backgrounds(real), noise, rng)
    more, of_crops = cropped_patches(taught, noise, rng)
    network = fit(np.concatenate([patches, more]), np.concatenate([names, of_crops]), seed)
    at_temperature(network, *still_patches(crops(real, VALIDATED)))
    held, truth = still_patches(crops(real, TESTED))
    best = network.log_probabilities(held).argmax(axis=1)
    right = float((np.array(network.classes)[best] == truth).mean())
    words = (
        f"{len(drawn)} vector drawings of signs (mapillary/mapillary_sprite_source and brycedorn/mutcd-ts, MIT), drawn "
        f"before images of {' and '.join(BACKGROUNDS)} (udacity/CarND-LaneLines-P1, MIT); {len(taught)} crops of GTSRB "
        f"(Stallkamp et al. 2012); held out by track, named right: {100 * right:.1f} % of {len(truth)}; seed {seed}"
    )
    out.mkdir(parents=True, exist_ok=True)
    export(network, out / FILE, words)
    print(f"{out / FILE}: {words}")


def drawn_patches(
    drawn: Sequence[FaceExample],
    backgrounds: Sequence[NDArray[np.uint8]],
    noise: Noise,
    rng: np.random.Generator,
) -> Patches:
    """`DRAWN` patches of each class of drawings, `DRAWN_OTHER` of all others, some of them invented boards."""
    by_name: dict[str, list[NDArray[np.uint8]]] = {}
    for one in drawn:
        by_name.setdefault(one.name, []).append(_shrunk(one.pixels))
    patches, names = [], []
    for name, own in by_name.items():
        for k in range(DRAWN_OTHER if name == OTHER_FACE else DRAWN):
            face = FaceDrawing(own[k % len(own)], NONE, NONE)
            if name == OTHER_FACE and rng.random() < 0.25:
                face, _ = chosen_face("board", FaceLibrary((), ()), rng)
            patches.append(_drawn(face, backgrounds, noise, rng))
            names.append(name)
    return np.stack(patches), np.array(names)


def cropped_patches(
    taught: Sequence[FaceExample], noise: Noise, rng: np.random.Generator
) -> Patches:
    """Copies of crops, each seen through another camera, from farther away, in a box a little off."""
    patches, names = [], []
    for one in taught:
        for _ in range(CROPPED):
            rgb, box = one.pixels, one.box
            shrink = rng.uniform(0.35, 1.0)
            if shrink * min(box[2:] - box[:2]) > HEIGHTS_PX[0] and rng.random() < 0.5:
                size = np.maximum(np.round(np.array(rgb.shape[1::-1]) * shrink), 8).astype(int)
                box = box * np.tile(size / rgb.shape[1::-1], 2)
                rgb = np.asarray(cv2.resize(rgb, size.tolist(), interpolation=cv2.INTER_AREA))
            patches.append(face_patch(through_a_camera(rgb, noise, rng), _moved(box, rng)))
            names.append(one.name)
    return np.stack(patches), np.array(names)


def _drawn(
    face: FaceDrawing,
    backgrounds: Sequence[NDArray[np.uint8]],
    noise: Noise,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """A patch of a drawing in a real background, through another camera."""
    height = float(np.exp(rng.uniform(*np.log(HEIGHTS_PX))))
    patch = seen_from_an_angle(face, height, rng)
    high, wide = patch.shape[:2]
    edge = round(0.15 * max(high, wide)) + 3
    whole = backgrounds[int(rng.integers(len(backgrounds)))]
    top = int(rng.integers(max(1, whole.shape[0] - high - 2 * edge)))
    left = int(rng.integers(max(1, whole.shape[1] - wide - 2 * edge)))
    shown = whole[top : top + high + 2 * edge, left : left + wide + 2 * edge].copy()
    box = (float(edge), float(edge), float(edge + wide), float(edge + high))
    wear(patch, FRONT, float(rng.uniform(*BRIGHTNESS)), shown, box, noise.smooth, rng)
    drawn = blend(shown, patch, edge, edge)
    seen = through_a_camera(shown, noise, rng)
    return face_patch(seen, _moved(np.array(drawn or box), rng))


def _shrunk(rgba: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A drawing no larger than faces are drawn, its colours weighted by their opacity."""
    scale = HEIGHTS_PX[1] / max(rgba.shape[:2])
    weighted = rgba.astype(np.float32)
    weighted[..., :3] *= weighted[..., 3:] / 255
    small = np.asarray(
        cv2.resize(weighted, (0, 0), fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.float32
    )
    small[..., :3] *= 255 / np.maximum(small[..., 3:], 1)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


def _moved(box: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """A box whose sides are as far off as those of measured boxes."""
    size = np.tile(box[2:] - box[:2], 2)
    return np.asarray(box + rng.normal(0, 1, 4) * (BOX_SIGMA * size + BOX_SIGMA_PX))


def _backgrounds(real: Path) -> list[NDArray[np.uint8]]:
    """Every eighth image of the drives that drawings are put before."""
    return [
        image.rgb
        for name in BACKGROUNDS
        for k, image in enumerate(images(real / f"{name}.mcap"))
        if k % 8 == 0 and image.rgb is not None
    ]


def main(arguments: list[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m training.face_codes", description=__doc__)
    parser.add_argument("--real", type=Path, required=True, help="folder of drawings and crops")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the model file")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    return run(lambda: learn_face_codes(given.real, given.seed, given.out))


if __name__ == "__main__":
    sys.exit(main())
