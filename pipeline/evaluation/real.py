"""Compare reported signs with hand-made boxes on images of a real drive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wayside.pipeline.evaluation.figures import (
    Duplicate,
    FalseSign,
    KindCount,
    RealEvaluation,
    Row,
)
from wayside.pipeline.evaluation.misses import Face
from wayside.pipeline.labels.box_matching import Box, overlap

NO_KIND = "other"
"""Kind of a wanted sign whose label names none, where others do."""


def evaluate_against_labels(
    signs: Sequence[Row], observations: Iterable[Row], labels: Row
) -> RealEvaluation:
    """A label is found where a reported sign has an observation on its box in a labelled image.

    Parameters
    ----------
    signs
        Rows of `signs.parquet` with status `sign`.
    observations
        Rows of `observations.parquet` in frames where anything is boxed: `sign_id`, `frame`, `box`.
    labels
        Content of a `labels.json`.
    """
    seen = {sign["sign_id"]: {sign["best_frame"]: sign["best_box"]} for sign in signs}
    for row in observations:
        if row["sign_id"] in seen:
            seen[row["sign_id"]][row["frame"]] = row["box"]

    names = list(seen)
    boxes = [_boxes(label, labels["stride"]) for label in labels["signs"]]
    on_label = np.array(
        [[_overlap(views, known) for known in boxes] for views in seen.values()], np.float64
    ).reshape(len(names), len(boxes))
    touching = {names[i] for i in np.flatnonzero(on_label.any(axis=1))}
    wanted = [label for label in labels["signs"] if label["wanted"]]
    seen_labels = {labels["signs"][j]["id"] for j in np.flatnonzero(on_label.any(axis=0))}
    found = {label["id"] for label in wanted} & seen_labels
    return RealEvaluation(
        wanted=len(wanted),
        found=tuple(sorted(found)),
        touching=len(touching),
        false=tuple(
            _false(sign, seen[sign["sign_id"]], labels)
            for sign in signs
            if sign["sign_id"] not in touching
        ),
        missed=tuple(label["id"] for label in wanted if label["id"] not in found),
        duplicates=_duplicates(names, on_label, [label["id"] for label in labels["signs"]]),
        kinds=_kinds(wanted, found),
    )


def missed_faces(evaluation: RealEvaluation, labels: Row) -> list[Face]:
    """The missed labels with all their boxes."""
    by_id = {label["id"]: label for label in labels["signs"]}
    return [Face(name, _boxes(by_id[name], labels["stride"])) for name in evaluation.missed]


def labelled_frames(labels: Row) -> set[int]:
    """Frames in which anything is boxed."""
    things = [*labels["signs"], *labels["distractors"]]
    boxes = [_boxes(thing, labels["stride"]) for thing in things]
    return {frame for views in boxes for frame in views}


def _duplicates(
    names: Sequence[str], on_label: NDArray[np.float64], labels: Sequence[str]
) -> tuple[Duplicate, ...]:
    """Rows that are left over where each label has one row of its own, so that all overlap most (rows, labels)."""
    rows, columns = linear_sum_assignment(on_label, maximize=True)
    owner = {int(j): int(i) for i, j in zip(rows, columns, strict=True) if on_label[i, j] > 0}
    left = set(range(len(names))) - set(owner.values())
    best = {i: int(on_label[i].argmax()) for i in sorted(left) if on_label[i].any()}
    return tuple(Duplicate(names[i], labels[j], names[owner[j]]) for i, j in best.items())


def _kinds(wanted: Sequence[Row], found: set[str]) -> tuple[KindCount, ...]:
    """The wanted by kind, the most frequent first; none where no label names its kind."""
    kinds = Counter(label.get("kind", NO_KIND) for label in wanted)
    right = Counter(label.get("kind", NO_KIND) for label in wanted if label["id"] in found)
    if set(kinds) <= {NO_KIND}:
        return ()
    return tuple(KindCount(kind, count, right[kind]) for kind, count in kinds.most_common())


def _boxes(thing: Row, stride: int) -> dict[int, Box]:
    """Boxes of a label or a distractor by frame; some distractors are boxed in one source image alone."""
    boxes = {entry["i"]: entry["box"] for entry in thing.get("boxes", ())}
    if "box" in thing:
        boxes[thing["source_frame"] // stride] = thing["box"]
    return boxes


def _overlap(views: Mapping[int, Box], boxes: Mapping[int, Box]) -> float:
    """Sum of the overlaps (IoU) over the frames where views and boxes show the same thing."""
    return sum(
        float(overlap(np.array([box]), boxes[frame])[0])
        for frame, box in views.items()
        if frame in boxes
    )


def _false(sign: Row, views: Mapping[int, Box], labels: Row) -> FalseSign:
    """A sign on no label, with the known distractor it lies on; distractors are boxed in one source image."""
    on = (
        thing["what"]
        for thing in labels["distractors"]
        if _overlap(views, _boxes(thing, labels["stride"]))
    )
    return FalseSign.of(sign, next(on, "unlabelled"))
