"""Compare reported signs with hand-made boxes on images of a real drive."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wayside.pipeline.evaluation.figures import (
    FALSE_COLUMNS,
    NO_KIND,
    Duplicate,
    RealEvaluation,
    Row,
)
from wayside.pipeline.evaluation.misses import Face
from wayside.pipeline.labels.box_matching import Box, overlap

Views = Mapping[int, Box]
"""Boxes by frame."""


def evaluate_against_labels(
    signs: Sequence[Row], observations: Iterable[Row], labels: Row
) -> RealEvaluation:
    """A label is found where a reported sign has an observation on its box in a labelled image.

    `signs`: rows of `signs.parquet` with status `sign`. `observations`: rows of `observations.parquet` in frames where
    anything is boxed: `sign_id`, `frame`, `box`. `labels`: content of a `labels.json`.
    """
    seen = {sign["sign_id"]: {sign["best_frame"]: sign["best_box"]} for sign in signs}
    for row in observations:
        if row["sign_id"] in seen:
            seen[row["sign_id"]][row["frame"]] = row["box"]
    things, stride = labels["signs"], labels["stride"]
    boxes = [_boxes(label, stride) for label in things]
    on_label = np.array(
        [[_overlap(views, known) for known in boxes] for views in seen.values()], np.float64
    ).reshape(len(seen), len(things))
    touched = {things[j]["id"] for j in np.flatnonzero(on_label.any(axis=0))}
    wanted = [label for label in things if label["wanted"]]
    kinds = [(label.get("kind", NO_KIND), label["id"] in touched) for label in wanted]
    touching = [bool(own.any()) for own in on_label]
    return RealEvaluation(
        wanted=len(wanted),
        found=tuple(sorted({label["id"] for label in wanted} & touched)),
        right=sum(touching),
        false=tuple(
            {name: sign[name] for name in FALSE_COLUMNS}
            | {"cause": _distractor(seen[sign["sign_id"]], labels)}
            for sign, right in zip(signs, touching, strict=True)
            if not right
        ),
        missed=tuple(label["id"] for label in wanted if label["id"] not in touched),
        duplicates=tuple(_duplicates(list(seen), on_label, [label["id"] for label in things])),
        by_kind=tuple(kinds) if any(kind != NO_KIND for kind, _ in kinds) else (),
    )


def missed_faces(evaluation: RealEvaluation, labels: Row) -> list[Face]:
    """The missed labels with all their boxes."""
    by_id = {label["id"]: label for label in labels["signs"]}
    return [Face(name, _boxes(by_id[name], labels["stride"])) for name in evaluation.missed]


def labelled_frames(labels: Row) -> set[int]:
    """Frames in which anything is boxed."""
    things = [*labels["signs"], *labels["distractors"]]
    return {frame for thing in things for frame in _boxes(thing, labels["stride"])}


def _duplicates(
    names: Sequence[str], on_label: NDArray[np.float64], labels: Sequence[str]
) -> Iterator[Duplicate]:
    """Rows that are left over where each label has one row of its own, so that all overlap most (rows, labels)."""
    pairs = zip(*linear_sum_assignment(on_label, maximize=True), strict=True)
    owner = {int(j): int(i) for i, j in pairs if on_label[i, j] > 0}
    for i in range(len(names)):
        if i not in owner.values() and on_label[i].any():
            best = int(on_label[i].argmax())
            yield Duplicate(names[i], labels[best], names[owner[best]])


def _boxes(thing: Row, stride: int) -> dict[int, Box]:
    """Boxes of a label or a distractor by frame; some distractors are boxed in one source image alone."""
    boxes = {entry["i"]: entry["box"] for entry in thing.get("boxes", ())}
    if "box" in thing:
        boxes[thing["source_frame"] // stride] = thing["box"]
    return boxes


def _overlap(views: Views, boxes: Views) -> float:
    """Sum of the overlaps (IoU) over the frames where views and boxes show the same thing."""
    return sum(
        float(overlap(np.array([box]), boxes[frame])[0])
        for frame, box in views.items()
        if frame in boxes
    )


def _distractor(views: Views, labels: Row) -> str:
    """The known distractor that a row lies on."""
    things = labels["distractors"]
    on = (one["what"] for one in things if _overlap(views, _boxes(one, labels["stride"])))
    return next(on, "unlabelled")
