"""What the script of the index knows of a result, so that a person can correct it and place missing signs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from wayside.pipeline.reviewing.known import KnownResult
from wayside.pipeline.reviewing.matching import Review


def index_review(
    known: KnownResult, review: Review, pictures: Mapping[int, str], lens: Mapping[str, Any] | None
) -> dict[str, Any]:
    """The rows of the result, the review that the page begins with, what is to be decided, and the cameras.

    pictures: addresses of images of what is to be decided, by number. lens: `camera` of `run.json`, without whose
    distortion the images are shown; None: there are no images.
    """
    cameras = [
        {"image": image, "x": one["x"], "y": one["y"], **known.measure(one["station_m"] or 0.0)}
        | {"turn": [round(value, 6) for value in one["turn"]]}
        for image, one in known.cameras.items()
    ]
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
        "result": known.name,
        "rows": {sign_id: row.to_row() for sign_id, row in known.rows.items()},
        "reviews": reviewed,
        "seed": hashlib.sha256(told.encode()).hexdigest()[:8] if reviewed or undecided else "",
        "undecided": undecided,
        "cameras": cameras,
        "unit": next((one["measure_unit"] for one in known.measured), None),
        "lens": lens,
    }
