"""How the scores of the box classifier and of the detection network are joined.

    python -m wayside.pipeline.learning.network_sum --drives FOLDER -o MODELS

A logistic regression on the boxes that pass the pre-filter, on rendered drives that neither has learned from. The
folder of models has both; `judge.json` there is written anew. Its threshold stays, and the shift of the sum is such
that as many boxes off the faces are accepted there as by the box classifier alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.flow import Flow
from wayside.pipeline.learn import learning_logs, write_model
from wayside.pipeline.learning.cross_validation import platt
from wayside.pipeline.learning.detector import FALSE_PER_IMAGE
from wayside.pipeline.learning.samples import (
    LEARN_READ,
    NEAR_FACE,
    NEITHER,
    ON,
    SignViews,
    TrueFaces,
    for_each,
    labelled,
    read_truth,
)
from wayside.pipeline.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError, WaysideError
from wayside.schemas.models import NetworkSum, TreeModel
from wayside.stages.geometry import non_maximum_suppression

EVERY = 4
"""Every n-th image of a drive: three numbers are learned."""

BELOW_THRESHOLD = 4.0
"""Boxes whose log odds by the classifier are farther below its threshold are out of reach of the network."""


@dataclass(frozen=True, slots=True)
class ScoredBoxes:
    """Boxes of one image, n rows: box (n, 4), score (n, 2) by classifier and network, label (n,), overlap (n,)."""

    box: NDArray[np.float32]
    score: NDArray[np.float32]
    label: NDArray[np.int8]
    overlap: NDArray[np.float32]


def learn_network_sum(
    images: Sequence[ScoredBoxes], threshold: float, max_iou: float
) -> NetworkSum:
    """The sum that is a log odds, but for a shift by which it has the `threshold` of the classifier.

    max_iou: overlap above which the lower of two boxes of an image is suppressed.

    Raises
    ------
    InputError
        Without boxes on faces, or off them.
    """
    score = np.concatenate([one.score for one in images])
    label = np.concatenate([one.label for one in images])
    some = (label != NEITHER) & (score[:, 0] >= threshold - BELOW_THRESHOLD)
    on = label[some] == ON
    if on.all() or not on.any():
        raise InputError(
            "scores: wanted boxes on faces and off them, found one kind only; add drives"
        )
    (own, network), _ = platt(score[some], on)
    joined = [one.score @ np.array([own, network]) for one in images]
    at = threshold_of(images, joined, max_iou)
    return NetworkSum(float(own), float(network), float(threshold - at))


def threshold_of(
    images: Sequence[ScoredBoxes], scores: Sequence[NDArray[np.floating]], max_iou: float
) -> float:
    """The score from which `FALSE_PER_IMAGE` boxes an image lie on no face, after suppression."""
    false: list[NDArray[np.floating]] = []
    for one, score in zip(images, scores, strict=True):
        order = np.argsort(-score, kind="stable")
        kept = order[non_maximum_suppression(one.box[order], max_iou)]
        false.append(score[kept][one.overlap[kept] < NEAR_FACE])
    falling = np.sort(np.concatenate(false))[::-1]
    allowed = round(FALSE_PER_IMAGE * len(images))
    return float(falling[min(allowed, len(falling) - 1)])


def scored_boxes(log: Path, folder: Path) -> list[ScoredBoxes]:
    """The boxes of a rendered drive that pass the pre-filter, scored by the models of a folder."""
    settings, _ = load_settings("default", None, [], {"models.folder": str(folder)})
    models = load_models(settings)
    if models.box_classifier is None or models.detection_network is None:
        raise InputError(f"{folder}: wanted a box classifier and a detection network")
    alone = replace(models.box_classifier, with_network=None)
    truth = read_truth(log.with_suffix(".truth.json"))
    seen: dict[int, SignViews] = {}
    for sign in truth["signs"]:
        for view in sign["frames"]:
            if sign["faces_travel"]:
                seen.setdefault(view["frame"], []).append((sign, view))
    frames = (f for f in read_frames(log, LEARN_READ, ReadReport()) if f.index % EVERY == 0)
    found = []
    for item in Flow(settings, replace(models, box_classifier=alone), StageClock()).detect(frames):
        network = item.segmentation.network_score
        if network is None:
            continue
        rows = np.flatnonzero(np.isfinite(item.candidates.score))
        regions = item.candidates.regions.select(rows)
        faces = TrueFaces.of([seen.get(item.frame.index, [])], [True])
        nothing = np.zeros((len(rows), 0), np.float32)
        known = labelled(regions, nothing, np.zeros(len(rows), np.int32), faces)
        score = np.stack([item.candidates.score[rows], network[rows]], axis=1)
        found.append(ScoredBoxes(regions.box, score, known.label, known.overlap))
    return found


def main(arguments: list[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m wayside.pipeline.learning.network_sum")
    parser.add_argument("--drives", type=Path, required=True, help="folder of rendered drives")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the model files")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    try:
        logs = learning_logs(given.drives)
        settings, _ = load_settings("default", None, [], {"models.folder": str(given.out)})
        model = load_models(settings).box_classifier
        if not isinstance(model, TreeModel):
            raise InputError(f"{given.out}: wanted a box classifier, found none")
        found = for_each(lambda log: scored_boxes(log, given.out), logs)
        images = [image for drive in found for image in drive]
        joined = learn_network_sum(images, model.threshold, settings.candidates.same_face_iou)
        known = model.provenance.partition("; joined with the network by ")[0]
        origin = f"{known}; joined with the network by {len(images)} images of {len(logs)} drives"
        learned = replace(model, with_network=joined, provenance=origin)
        write_model(given.out / "judge.json", learned, lambda text: print(text[-300:]))
        print(joined)
    except WaysideError as error:
        print(f"wayside: {error}", file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
