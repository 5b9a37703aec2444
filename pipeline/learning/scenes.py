"""Real images as samples for the box classifiers and the names of faces, and the sources that may be learned from.

Single images have no calibration: a field of view of a common camera is assumed, so that angles of sizes and places are
of the right order.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.detector_crops import MOST_DISTRACTORS, make_noise
from wayside.pipeline.learning.detector_images import (
    BACK,
    FRONT,
    LabelledImage,
    real_drive_images,
    scene_set_images,
)
from wayside.pipeline.learning.distractor_drawings import draw_distractor
from wayside.pipeline.learning.face_compositing import beside_the_road, draw_faces
from wayside.pipeline.learning.face_drawings import FaceLibrary
from wayside.pipeline.learning.faces import FaceSample, real_face
from wayside.pipeline.learning.samples import SignViews, TrainingDrive, TrueFaces, read_drive_images
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.schemas.frame import USED, Camera, Frame, Image
from wayside.schemas.models import OnnxFile
from wayside.schemas.settings import Settings

FOCAL_FRACTION = 0.9
"""Focal length of the unknown cameras as a fraction of the image's longer side."""

FEW, COPIES = 100, 3
"""A source of fewer images is read several times, mostly altered."""

DRAWN_FRACTION, MOST_POSTS = 0.5, 6
"""Fraction of the real images into which faces are drawn; most posts with faces in one."""


def real_sources(folder: Path) -> dict[str, Callable[[], Iterator[LabelledImage]]]:
    """The sources of a folder of real images that the models of one image are learned from, by name.

    Only what its README marks as fit for that; what is not here is for tests. A source is held out as a whole.
    """
    drives = {"us_freeway_challenge": True, "us_freeway_white_right": True, "ca_city_garmin": False}
    sources: dict[str, Callable[[], Iterator[LabelledImage]]] = {
        name: partial(real_drive_images, folder / f"{name}.mcap", complete=complete)
        for name, complete in drives.items()
    }
    for prefix in ("jd", "mi"):
        read = partial(scene_set_images, folder / "scenes", (f"{prefix}_",))
        sources[f"scenes/{prefix}"] = read
    for name in ("scenes_mixed", "scenes_speed_us"):
        sources[name] = partial(scene_set_images, folder / name)
    return sources


def labelled_images(source: Callable[[], Iterator[LabelledImage]]) -> list[LabelledImage]:
    """All images of a source; those of a small one several times."""
    images = list(source())
    return images * (COPIES if len(images) < FEW else 1)


def with_drawn_faces(
    labelled: Sequence[LabelledImage], library: FaceLibrary, seed: int
) -> list[LabelledImage]:
    """The images, some with further faces drawn in beside the road: real ones show few kinds of signs."""
    side = max(max(one.rgb.shape[:2]) for one in labelled) + 1
    noise = make_noise(np.random.default_rng(seed), side).smooth
    shown = []
    for index, one in enumerate(labelled):
        rng = np.random.default_rng((seed, index, zlib.crc32(one.source.encode())))
        shown.append(
            _with_faces(one, library, noise, rng) if rng.random() < DRAWN_FRACTION else one
        )
    return shown


def _with_faces(
    one: LabelledImage,
    library: FaceLibrary,
    noise: NDArray[np.float32],
    rng: np.random.Generator,
) -> LabelledImage:
    rgb = one.rgb.copy()
    posts = int(rng.integers(1, MOST_POSTS + 1))
    taken = np.concatenate([one.box, one.ignored])
    drawn = draw_faces(rgb, taken, library, noise, rng, posts, beside_the_road(camera_of(one)))
    box = np.concatenate([one.box, np.array([d.box for d in drawn], np.float32).reshape(-1, 4)])
    for _ in range(int(rng.integers(0, MOST_DISTRACTORS + 1))):
        draw_distractor(rgb, np.concatenate([box, one.ignored]), rng)
    return replace(
        one,
        rgb=rgb,
        box=box,
        side=np.append(one.side, [d.side for d in drawn]).astype(np.int8),
        color=np.append(one.color, [d.color for d in drawn]).astype(np.int8),
        shape=np.append(one.shape, [d.shape for d in drawn]).astype(np.int8),
    )


def camera_of(one: LabelledImage) -> Camera:
    """The camera of an image; a common one where it is not known."""
    height, width = one.rgb.shape[:2]
    focal = FOCAL_FRACTION * max(width, height)
    return one.camera or Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def as_images(labelled: Iterable[LabelledImage]) -> Iterator[Image]:
    """The images as a run would have them, numbered from 0."""
    for index, one in enumerate(labelled):
        height, width = one.rgb.shape[:2]
        camera = camera_of(one)
        frame = Frame(index, index, None, USED, "jpeg", b"", camera, width, height)
        yield Image(frame, one.rgb, np.asarray(cv2.cvtColor(one.rgb, cv2.COLOR_RGB2GRAY), np.uint8))


def scene_drive(
    images: Iterable[Image],
    source: str,
    labelled: list[LabelledImage],
    settings: Settings,
    network: OnnxFile | None = None,
) -> TrainingDrive:
    """The images of one source as a drive without places or clear faces; `images` are `labelled`, altered or not.

    What lies where nothing is known of an image is neither a face nor the lack of one.
    """
    fronts = [_views(one, back=False) for one in labelled]
    backs = [_views(one, back=True) for one in labelled]
    drive = read_drive_images(
        source,
        images,
        fronts,
        [True] * len(labelled),
        settings,
        network,
        [one.ignored for one in labelled],
    )
    complete = [one.backs_complete for one in labelled]
    return replace(drive, backs=TrueFaces.of(backs, complete))


def real_faces(images: Iterable[LabelledImage]) -> list[FaceSample]:
    """The fronts of signs of known colour and shape in real images."""
    found: list[FaceSample] = []
    for image in images:
        for row in np.flatnonzero(image.side == FRONT):
            color, shape = image.color[row], image.shape[row]
            if color != NONE and shape != NONE:
                name = f"{image.name}/{row}"
                found += real_face(image.rgb, COLORS[color], SHAPES[shape], image.box[row], name)
    return found


def _views(one: LabelledImage, *, back: bool) -> SignViews:
    return [
        (
            {
                "id": f"{one.name}/{row}",
                "color": _name(COLORS, one.color[row]),
                "shape": _name(SHAPES, one.shape[row]),
            },
            {"box": box, "visible_fraction": 1.0, "side": "back" if back else "front"},
        )
        for row, box in enumerate(one.box.tolist())
        if (one.side[row] == BACK) == back
    ]


def _name(names: tuple[str, ...], code: int) -> str:
    return "" if code == NONE else names[code]
