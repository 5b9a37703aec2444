"""Real images with boxed signs as samples for the box classifier and the names of faces.

The images stand alone: no drive, no calibration. A field of view of a common camera is assumed, so that angles of
sizes and places are of the right order.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wayside.pipeline.learning.samples import TrainingDrive, read_drive_images
from wayside.schemas.errors import InputError
from wayside.schemas.frame import USED, Camera, Frame, Image
from wayside.schemas.settings import Settings

FOCAL_FRACTION = 0.9
"""Focal length of the unknown cameras as a fraction of the image's longer side."""


def read_scenes(folder: Path) -> list[dict[str, Any]]:
    """The list `scenes/scenes.json` of a folder of real images; raises InputError where it is none."""
    path = folder / "scenes" / "scenes.json"
    try:
        return list(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: wanted a list of scenes, found {error}; correct --real"
        ) from error


def scene_sources(scenes: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Scenes by the repository they are from, in order of its name: a source is held out as a whole."""
    sources: dict[str, list[dict[str, Any]]] = {}
    for scene in sorted(scenes, key=lambda s: (s["source_repo"], s["file"])):
        sources.setdefault(scene["source_repo"], []).append(scene)
    return sources


def scene_images(folder: Path, scenes: list[dict[str, Any]]) -> Iterator[Image]:
    """The images of some scenes, numbered from 0."""
    for index, scene in enumerate(scenes):
        path = folder / "scenes" / scene["file"]
        rgb = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
        if rgb is None:
            raise InputError(
                f"{path}: wanted an image, found none that can be read; correct --real"
            )
        height, width = rgb.shape[:2]
        focal = FOCAL_FRACTION * max(width, height)
        camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        frame = Frame(index, index, None, USED, "jpeg", b"", camera, width, height)
        pixels = np.ascontiguousarray(rgb, np.uint8)
        grey = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), np.uint8)
        yield Image(frame, pixels, grey)


def scene_drive(
    images: Iterable[Image], source: str, scenes: list[dict[str, Any]], settings: Settings
) -> TrainingDrive:
    """The scenes of one source as a drive without places or clear faces, from their images in the same order.

    Only complete scenes show what is no sign.
    """
    here = [
        [
            (
                {"id": f"{scene['file']}/{number}"} | sign,
                {"box": sign["box"], "visible_fraction": 1.0},
            )
            for number, sign in enumerate(scene["signs"])
        ]
        for scene in scenes
    ]
    complete = [bool(scene["complete"]) for scene in scenes]
    return read_drive_images(source, images, here, complete, settings)
