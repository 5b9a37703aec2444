"""The images that the networks of preset `default` are learned from: how often each is drawn, and their licences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.detector_images import LabelledImage, rendered_images
from wayside.pipeline.learning.face_drawings import FaceLibrary
from wayside.pipeline.learning.scenes import real_sources

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


def held_out_images(real: Path, sources: Collection[str]) -> list[LabelledImage]:
    """The images of real sources by their names; raises InputError where there is none of such a name."""
    left = real_sources(real, sources)
    return [
        image for name, read in real_sources(real).items() if name not in left for image in read()
    ]


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
