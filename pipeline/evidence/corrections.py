"""What the script of the index knows of a result, so that a person can correct it and place missing signs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from wayside.pipeline.reviewing.matching import Review, Rows
from wayside.pipeline.reviewing.places import turn_of
from wayside.schemas.frame import Camera
from wayside.stages.geometry import to_rays

_GRID = 17, 13
"""Pixels whose rays the page knows, across and down; between them it interpolates, to 0.1 px for usual lenses."""


def index_review(
    known: Rows, review: Review, pictures: Mapping[int, str], camera: dict[str, Any] | None
) -> dict[str, Any]:
    """The rows of the result, the review that the page begins with, what is to be decided, and the cameras.

    pictures: addresses of images of what is to be decided, by number. camera: as in `run.json`; None: without images.
    """
    cameras = []
    for one in known.places.cameras:
        station = one["station_m"] or 0.0
        measure = known.places.measure(station)
        cameras.append(
            {name: one[name] for name in ("image", "x", "y")}
            | {"turn": np.round(turn_of(one)[:2].ravel(), 6).tolist(), "station": station}
            | {"measure": measure.get("measure"), "unit": measure.get("measure_unit")}
        )
    reviewed = [one.to_row() for one in (*review.rows.values(), *review.missing)]
    undecided = [
        {
            "words": one.words,
            "picture": pictures.get(number, ""),
            "options": [
                {"words": words, "row": row and row.to_row()} for words, row in one.options
            ],
            "entries": [entry.to_row() for entry in one.entries],
        }
        for number, one in enumerate(review.undecided)
    ]
    told = json.dumps([reviewed, undecided])
    return {
        "rows": {sign_id: row.to_row() for sign_id, row in known.rows.items()},
        "review": {"reviews": reviewed},
        "seed": f" {hashlib.sha256(told.encode()).hexdigest()[:8]}"
        if reviewed or undecided
        else "",
        "undecided": undecided,
        "cameras": cameras,
        "unit": cameras[0]["unit"] if cameras else None,
        "rays": None if camera is None else _rays(camera),
    }


def _rays(camera: Mapping[str, Any]) -> dict[str, Any]:
    """x/z, y/z of a grid of pixels, row by row, from edge to edge of the image."""
    across, down = _GRID
    lens = Camera(**{**camera, "distortion": tuple(camera["distortion"])})
    u, v = np.meshgrid(
        np.linspace(-0.5, lens.width - 0.5, across), np.linspace(-0.5, lens.height - 0.5, down)
    )
    rays = to_rays(lens, np.stack([u.ravel(), v.ravel()], axis=1))
    return {"columns": across, "values": np.round(rays, 6).tolist()}
