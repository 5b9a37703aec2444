"""Compare reported signs with hand-made boxes on images of a real drive."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from wayside.pipeline.evaluation import FalseSign, RealEvaluation
from wayside.stages.geometry import box_areas, iou_matrix

SMALLEST_IOU, LARGEST_AREA_RATIO = 0.3, 5.0

Row = Mapping[str, Any]
Box = Sequence[float]


def evaluate_against_labels(
    signs: Sequence[Row], observations: Iterable[Row], labels: Row
) -> RealEvaluation:
    """A label is found where a reported sign has an observation on its box in a labelled image.

    Parameters
    ----------
    signs
        Rows of `signs.parquet` with status `sign`.
    observations
        Rows of `observations.parquet`: `sign_id`, `frame`, `box`.
    labels
        Content of a `labels.json`.
    """
    seen = {sign["sign_id"]: {sign["best_frame"]: sign["best_box"]} for sign in signs}
    for row in observations:
        if row["sign_id"] in seen:
            seen[row["sign_id"]][row["frame"]] = row["box"]

    found, touching = set(), set()
    for label in labels["signs"]:
        boxes = {entry["i"]: entry["box"] for entry in label.get("boxes", ())}
        on_it = [name for name, views in seen.items() if _meet(views, boxes)]
        touching.update(on_it)
        if on_it and label["wanted"]:
            found.add(label["id"])

    wanted = [label["id"] for label in labels["signs"] if label["wanted"]]
    return RealEvaluation(
        wanted=len(wanted),
        found=tuple(sorted(found)),
        touching=len(touching),
        false=tuple(
            _false(sign, seen[sign["sign_id"]], labels)
            for sign in signs
            if sign["sign_id"] not in touching
        ),
        missed=tuple(name for name in wanted if name not in found),
    )


def same_thing(a: Box, b: Box) -> bool:
    """Whether boxes overlap well, or `a` has its centre in `b` and about its size."""
    first, second = np.array([a]), np.array([b])
    if iou_matrix(first, second)[0, 0] >= SMALLEST_IOU:
        return True
    ratio = max(box_areas(first)[0], 1e-9) / max(box_areas(second)[0], 1e-9)
    u, v = (a[0] + a[2]) / 2, (a[1] + a[3]) / 2
    inside = b[0] <= u <= b[2] and b[1] <= v <= b[3]
    return bool(inside and 1 / LARGEST_AREA_RATIO <= ratio <= LARGEST_AREA_RATIO)


def _meet(views: Mapping[int, Box], boxes: Mapping[int, Box]) -> bool:
    return any(frame in boxes and same_thing(box, boxes[frame]) for frame, box in views.items())


def _false(sign: Row, views: Mapping[int, Box], labels: Row) -> FalseSign:
    """A sign on no label, with the known distractor it lies on; distractors are boxed in one source image."""
    cause = "unlabelled"
    for distractor in labels["distractors"]:
        boxes = {entry["i"]: entry["box"] for entry in distractor.get("boxes", ())}
        if "box" in distractor:
            boxes[distractor["source_frame"] // labels["stride"]] = distractor["box"]
        if _meet(views, boxes):
            cause = distractor["what"]
            break
    return FalseSign(
        sign["sign_id"],
        sign["best_frame"],
        tuple(sign["best_box"]),
        sign["color"],
        sign["shape"],
        None,
        cause,
    )
