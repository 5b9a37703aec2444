"""Learning of the face classifier: `python -m training.face_codes --real FOLDER -o MODELS`.

It is taught by vector drawings, seen from an angle, worn, before real backgrounds and through other cameras, and by
real crops. Whole tracks of those choose its temperature, and other whole tracks measure it.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

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
from training.networks import write_onnx
from training.truth import OUT, REAL, SEED, command, images
from wayside.schemas.detections import NONE
from wayside.stages import sign_codes
from wayside.stages.kernels import Array, Bytes

FILTERS, HIDDEN = (16, 32, 64), 64
"""Filters of each layer, whose output is halved each way; units behind them."""

BATCH, EPOCHS, LEARNING_RATE, WEIGHT_DECAY, DROPOUT = 128, 6, 5e-3, 1e-2, 0.2
"""Patches of a batch, epochs, largest learning rate, weight decay, fraction of hidden units dropped."""

GREY, RESPONSE = 64, (2.0, 3.0, 1.5)
"""So many patches of a batch are seen once more by a grey sensor, whose response to red, green and blue is drawn from a
Dirichlet distribution: one that sees infrared shows red as white."""

SMOOTHING = 0.02
"""Part of the probability that is given to all classes alike."""

TEMPERATURES = tuple(np.geomspace(0.5, 4.0, 25).tolist())
"""By which log odds may be divided; the one of the best likelihood of the validated tracks is taken."""


class FaceNetwork(nn.Module):  # type: ignore[misc]
    """Samples (n, 3, 32, 32) of `face_samples` to scores (n, classes)."""

    def __init__(self, classes: Sequence[str]) -> None:
        super().__init__()
        self.classes = tuple(classes)
        layers: list[nn.Module] = []
        for before, after in zip((3, *FILTERS), FILTERS, strict=False):
            layers += [nn.Conv2d(before, after, 3, padding=1, bias=False), nn.BatchNorm2d(after)]
            layers += [nn.ReLU(), nn.MaxPool2d(2)]
        self.layers = nn.Sequential(*layers)
        samples = FILTERS[-1] * (sign_codes.PATCH_SIDE // 2 ** len(FILTERS)) ** 2
        self.hidden = nn.Sequential(nn.Linear(samples, HIDDEN), nn.ReLU(), nn.Dropout(DROPOUT))
        self.out = nn.Linear(HIDDEN, len(self.classes))

    def forward(self, samples: Tensor) -> Tensor:
        """Scores whose softmax is the probability of each class."""
        return self.out(self.hidden(self.layers(samples).flatten(1)))

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def log_probabilities(self, patches: Bytes) -> Array:
        """Log probability (n, classes) of each class for patches (n, 32, 32, 3)."""
        self.eval()
        scores = self(torch.from_numpy(sign_codes.face_samples(patches)))
        return np.asarray(torch.log_softmax(scores.double(), dim=1).numpy(), np.float64)


def fit(patches: Bytes, names: NDArray[np.str_], seed: int) -> FaceNetwork:
    """Fit the network to patches (n, 32, 32, 3) in colour and grey, and their classes (n,), drawn alike but `other`."""
    torch.manual_seed(seed)
    classes, target = np.unique(names, return_inverse=True)
    network = FaceNetwork(tuple(map(str, classes)))
    steps = round(EPOCHS * len(names) / BATCH)
    descent = torch.optim.AdamW(network.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    rate = torch.optim.lr_scheduler.OneCycleLR(
        descent, LEARNING_RATE, total_steps=steps, pct_start=0.15
    )
    other = sign_codes.OTHER_SHARE
    share = np.where(
        classes == sign_codes.OTHER_FACE, other, (1 - other) / max(len(classes) - 1, 1)
    )
    weight = (share / np.bincount(target))[target]
    random = np.random.default_rng(seed)
    drawn = random.choice(len(names), (steps, BATCH), p=weight / weight.sum())
    for batch in drawn:
        rows = np.append(batch, batch[:GREY])
        seen = np.concatenate([patches[batch], in_grey(patches[batch[:GREY]], random)])
        found = network(torch.from_numpy(sign_codes.face_samples(seen)))
        loss = nn.functional.cross_entropy(
            found, torch.from_numpy(target[rows]), label_smoothing=SMOOTHING
        )
        descent.zero_grad()
        loss.backward()
        descent.step()
        rate.step()
    return network


def in_grey(patches: Bytes, random: np.random.Generator) -> Bytes:
    """Patches (n, h, w, 3) as grey sensors of any response see them: three equal channels."""
    response = random.dirichlet(RESPONSE, len(patches))
    grey = np.rint(np.einsum("nhwc,nc->nhw", patches, response)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


@torch.no_grad()  # type: ignore[untyped-decorator]
def at_temperature(network: FaceNetwork, patches: Bytes, truth: NDArray[np.str_]) -> None:
    """Divide its scores by the temperature of the best likelihood (Guo et al. 2017)."""
    column = [network.classes.index(name) for name in truth]
    scores = network.log_probabilities(patches)

    def likelihood(temperature: float) -> float:
        divided = scores / temperature
        return float(
            (divided[range(len(column)), column] - np.logaddexp.reduce(divided, axis=1)).mean()
        )

    best = max(TEMPERATURES, key=likelihood)
    for values in network.out.parameters():
        values.div_(best)


def export(network: FaceNetwork, path: Path, provenance: str) -> None:
    """Write the network as ONNX, with its classes and provenance as metadata; needs the package onnx."""
    write_onnx(
        network,
        path,
        (torch.zeros(2, 3, sign_codes.PATCH_SIDE, sign_codes.PATCH_SIDE),),
        ([sign_codes.FACES], [sign_codes.FACE_OUTPUT]),
        {name: {0: "faces"} for name in (sign_codes.FACES, sign_codes.FACE_OUTPUT)},
        {"provenance": provenance, sign_codes.CLASSES: "\n".join(network.classes)},
    )


FILE = "face_code.onnx"

BACKGROUNDS = ("us_freeway_challenge", "us_freeway_white_right")
"""Real drives (MIT) before whose images the drawings are put."""

DRAWN, DRAWN_OTHER, CROPPED = 300, 9_000, 16
"""Patches of each drawn class, of all other faces together, and copies of each real crop."""

HEIGHTS_PX = (11.0, 80.0)
"""Heights of drawn faces, log-uniform."""

BOX_SIGMA, BOX_SIGMA_PX = 0.025, 0.5
"""Scatter of the sides of a face's box: as a fraction of its size, and in pixels."""

Patches = tuple[Bytes, NDArray[np.str_]]


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
    backgrounds: Sequence[Bytes],
    noise: Noise,
    rng: np.random.Generator,
) -> Patches:
    """`DRAWN` patches of each class of drawings, `DRAWN_OTHER` of all others, some of them invented boards."""
    by_name: dict[str, list[Bytes]] = {}
    for one in drawn:
        by_name.setdefault(one.name, []).append(_shrunk(one.pixels))
    patches, names = [], []
    for name, own in by_name.items():
        for k in range(DRAWN_OTHER if name == sign_codes.OTHER_FACE else DRAWN):
            face = FaceDrawing(own[k % len(own)], NONE, NONE)
            if name == sign_codes.OTHER_FACE and rng.random() < 0.25:
                face = chosen_face("board", FaceLibrary((), ()), rng)
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
            patches.append(
                sign_codes.face_patch(through_a_camera(rgb, noise, rng), _moved(box, rng))
            )
            names.append(one.name)
    return np.stack(patches), np.array(names)


def _drawn(
    face: FaceDrawing, backgrounds: Sequence[Bytes], noise: Noise, rng: np.random.Generator
) -> Bytes:
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
    return sign_codes.face_patch(seen, _moved(np.array(drawn or box), rng))


def _shrunk(rgba: Bytes) -> Bytes:
    """A drawing no larger than faces are drawn, its colours weighted by their opacity."""
    scale = HEIGHTS_PX[1] / max(rgba.shape[:2])
    weighted = rgba.astype(np.float32)
    weighted[..., :3] *= weighted[..., 3:] / 255
    small = np.asarray(
        cv2.resize(weighted, (0, 0), fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.float32
    )
    small[..., :3] *= 255 / np.maximum(small[..., 3:], 1)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


def _moved(box: Array, rng: np.random.Generator) -> Array:
    """A box whose sides are as far off as those of measured boxes."""
    size = np.tile(box[2:] - box[:2], 2)
    return np.asarray(box + rng.normal(0, 1, 4) * (BOX_SIGMA * size + BOX_SIGMA_PX))


def _backgrounds(real: Path) -> list[Bytes]:
    """Every eighth image of the drives that drawings are put before."""
    return [rgb for name in BACKGROUNDS for _, rgb in images(real / f"{name}.mcap", 8)]


main = command(__doc__, learn_face_codes, real=REAL, seed=SEED, out=OUT)

if __name__ == "__main__":
    sys.exit(main())
