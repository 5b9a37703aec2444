"""The images that the networks of preset `default` are learned from: how often each is drawn, and their licences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from training.detector_images import (
    LabelledImage,
    real_drive_images,
    rendered_images,
    scene_set_images,
)
from training.face_drawings import FaceLibrary
from wayside.schemas.errors import InputError

WEIGHTS = {
    "rendered": 0.35,
    "us_freeway_challenge": 0.03,
    "us_freeway_white_right": 0.03,
    "ca_city_garmin": 0.14,
    "scenes": 0.10,
    "scenes_speed_us": 0.12,
    "scenes_mixed": 0.23,
}
"""How often an image of a kind of source is drawn; within a kind, sources are alike."""

LICENCES = {
    "rendered": "own",
    "us_freeway_challenge": "MIT (upstream)",
    "us_freeway_white_right": "MIT (upstream)",
    "ca_city_garmin": "MIT",
    "scenes": "MIT (named by the source)",
    "scenes_speed_us": "GPL-3.0 (file of the source)",
    "scenes_mixed": "CC0 1.0 (as published elsewhere), pictures 0-156 left out",
}
"""Licences of the kinds of sources, as found; those of the drawn faces are stated with them."""


def source_kind(source: str) -> str:
    """The kind of a source, a key of `WEIGHTS`."""
    return source.split("/")[0]


def drawing_probability(images: Sequence[LabelledImage]) -> NDArray[np.float64]:
    """How often each image is drawn, (images,)."""
    count = Counter(image.source for image in images)
    per_kind = Counter(source_kind(source) for source in count)
    share = [
        WEIGHTS[source_kind(i.source)] / per_kind[source_kind(i.source)] / count[i.source]
        for i in images
    ]
    return np.asarray(np.array(share) / np.sum(share), np.float64)


def real_sources(
    folder: Path, without: Collection[str] = ()
) -> dict[str, Callable[[], Iterator[LabelledImage]]]:
    """The sources of a folder of real images that the models of one image are learned from, by name.

    Only what its README marks as fit for that; what is not here is for tests. A source is held out as a whole:
    `without` names those to be left out. Raises InputError if a source has no such name.
    """
    drives = ("us_freeway_challenge", "us_freeway_white_right", "ca_city_garmin")
    sources: dict[str, Callable[[], Iterator[LabelledImage]]] = {
        name: partial(real_drive_images, folder / f"{name}.mcap") for name in drives
    }
    for prefix in ("jd", "mi"):
        read = partial(scene_set_images, folder / "scenes", (f"{prefix}_",))
        sources[f"scenes/{prefix}"] = read
    for name in ("scenes_mixed", "scenes_speed_us"):
        sources[name] = partial(scene_set_images, folder / name)
    if unknown := set(without) - sources.keys():
        raise InputError(
            f"there are no sources {', '.join(sorted(unknown))} to leave out among {', '.join(sources)}"
        )
    return {name: read for name, read in sources.items() if name not in without}


def training_images(
    drives: Path | None, real: Path | None, without: Collection[str] = ()
) -> list[LabelledImage]:
    """All images that are learned from; `without` names real sources that are held out."""
    images: list[LabelledImage] = []
    for log in sorted(drives.glob("learn_*.mcap")) if drives else []:
        images += rendered_images(log)
    for read in real_sources(real, without).values() if real else []:
        images += read()
    return images


def provenance(images: Sequence[LabelledImage], library: FaceLibrary, seed: int) -> dict[str, str]:
    """What networks were learned from."""
    count = Counter(image.source for image in images)
    faces: Counter[str] = Counter()
    for image in images:
        faces[image.source] += len(image.box)
    sources = [
        f"{name}: {count[name]} images, {faces[name]} faces, {LICENCES[source_kind(name)]}"
        for name in sorted(count)
    ]
    return {
        "sources": "; ".join(sources),
        "faces drawn in": f"{len(library.vector)} vector faces, MIT (mapillary_sprite_source, mutcd-ts); "
        f"{len(library.cut)} crops of GTSRB, public research set",
        "seed": str(seed),
    }
