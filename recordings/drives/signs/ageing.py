"""Weather on a sign: fading, grime, uneven colour and the shade of leaves."""

import cv2
import numpy as np

from recordings.drives.arrays import Singles
from recordings.drives.paint.texture import shrink
from recordings.drives.signs.face import Face


def aged(face: Face, rng: np.random.Generator, faded: bool, dapple: Singles | None) -> Singles:
    """Premultiplied linear RGBA (rows, columns, 4) of a panel after ageing, at half the painted size.

    `dapple` is a small image of the light that falls through leaves, 1 where it is full.
    """
    rows, columns = (max(3, round(n * 0.5)) for n in face.image.shape[:2])
    color = shrink(face.image, columns, rows) / 255.0
    alpha = shrink(face.alpha(), columns, rows) / 255.0
    light = np.power(color, 2.2)
    cast = rng.normal(1.0, 0.025, 3).astype(np.float32)
    light *= cast * np.float32(rng.uniform(0.9, 1.02))
    fade = rng.uniform(0.08, 0.24) if faded else rng.uniform(0.0, 0.06)
    grey = light.mean(axis=2, keepdims=True)
    light = light * (1 - fade) + fade * (0.4 * grey + 0.28)
    patches = rng.random((9, 9), np.float32)
    grime = cv2.resize(patches, (columns, rows), interpolation=cv2.INTER_CUBIC)
    slope = np.linspace(0.4, 1.0, rows, dtype=np.float32)[:, None]
    light *= (1 - np.float32(rng.uniform(0.04, 0.22)) * np.clip(grime * slope, 0, 1))[..., None]
    if dapple is not None:
        light *= cv2.resize(dapple, (columns, rows), interpolation=cv2.INTER_LINEAR)[..., None]
    return np.dstack([light * alpha[..., None], alpha])
