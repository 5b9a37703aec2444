"""Thresholds of the box classifiers, and how the scores of that of faces and of the detection network are joined.

    python -m wayside.pipeline.learning.box_thresholds --drives FOLDER -o MODELS

A logistic regression on the boxes that are classified, on rendered drives that no model of one image has learned
from, joins the scores of faces. The rule of each threshold is a number of boxes an image on no panel of its side, on
these drives. The sum is shifted so that its threshold is that of the classifier; the threshold of backs is replaced.
`judge.json` and `back.json` of the folder are written anew.
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
from wayside.pipeline.learning.backs import FALSE_PER_IMAGE as FALSE_BACKS
from wayside.pipeline.learning.cross_validation import platt
from wayside.pipeline.learning.detector import FALSE_PER_IMAGE as FALSE_FACES
from wayside.pipeline.learning.detector import false_boxes_rule
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
    views_by_frame,
)
from wayside.pipeline.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.statistics import Interval, resampled_interval
from wayside.pipeline.workers import StageClock
from wayside.schemas.detections import Candidates
from wayside.schemas.errors import InputError, WaysideError
from wayside.schemas.models import NetworkSum, TreeModel
from wayside.stages.geometry import non_maximum_suppression

EVERY = 4
"""Every n-th image of a drive: three numbers are learned."""

BELOW_THRESHOLD = 4.0
"""Boxes whose log odds by the classifier are farther below its threshold are out of reach of the network."""


@dataclass(frozen=True, slots=True)
class ScoredBoxes:
    """Boxes of one image, n rows, as what they may be: faces, or backs of panels.

    box: (n, 4); score (n, 2) by classifier and network, of backs (n, 1); label (n,), overlap (n,) with a true panel.
    """

    box: NDArray[np.float32]
    score: NDArray[np.float32]
    label: NDArray[np.int8]
    overlap: NDArray[np.float32]


def learn_network_sum(
    drives: Sequence[Sequence[ScoredBoxes]], threshold: float, max_iou: float
) -> tuple[NetworkSum, Interval | None]:
    """The sum that is a log odds, but for a shift by which it has the `threshold` of the classifier.

    drives: images of each; max_iou: overlap above which the lower of two boxes of an image is suppressed. With it the
    95 % interval of the threshold.

    Raises
    ------
    InputError
        Without boxes on faces, or off them.
    """
    images = [one for drive in drives for one in drive]
    score = np.concatenate([one.score for one in images])
    label = np.concatenate([one.label for one in images])
    some = (label != NEITHER) & (score[:, 0] >= threshold - BELOW_THRESHOLD)
    on = label[some] == ON
    if on.all() or not on.any():
        raise InputError(
            "scores: wanted boxes on faces and off them, found one kind only; add drives"
        )
    (own, network), _ = platt(score[some], on)
    at, interval = rule_threshold(drives, np.array([own, network]), FALSE_FACES, max_iou)
    shift = threshold - at
    if interval is not None:
        interval = Interval(interval.low + shift, interval.high + shift)
    return NetworkSum(float(own), float(network), float(shift)), interval


def rule_threshold(
    drives: Sequence[Sequence[ScoredBoxes]],
    weights: NDArray[np.float64],
    accepted: float,
    max_iou: float,
) -> tuple[float, Interval | None]:
    """The weighted score from which `accepted` boxes an image are on no panel, after suppression.

    With its 95 % interval by resampling the drives; None of a single one.
    """
    false = [
        np.concatenate([false_scores(one, one.score @ weights, max_iou) for one in drive])
        for drive in drives
    ]
    images = np.array([len(drive) for drive in drives])
    drive_of = np.repeat(np.arange(len(drives)), [len(one) for one in false])
    falling = np.argsort(-np.concatenate(false), kind="stable")
    scores, drive_of = np.concatenate(false)[falling], drive_of[falling]

    def at(times: NDArray[np.int64]) -> float:
        """The threshold, each drive counted so many times."""
        allowed = round(accepted * int(images @ times))
        row = int(np.searchsorted(np.cumsum(times[drive_of]), allowed, side="right"))
        return float(scores[min(row, len(scores) - 1)])

    return at(np.ones(len(drives), np.int64)), resampled_interval(len(drives), at)


def false_scores(
    one: ScoredBoxes, score: NDArray[np.floating], max_iou: float
) -> NDArray[np.floating]:
    """Scores of the boxes of an image that are on no panel, after suppression by `score` (n,)."""
    order = np.argsort(-score, kind="stable")
    kept = order[non_maximum_suppression(one.box[order], max_iou)]
    return score[kept][one.overlap[kept] < NEAR_FACE]


def scored_boxes(log: Path, folder: Path) -> tuple[list[ScoredBoxes], list[ScoredBoxes]]:
    """The boxes of a rendered drive that are classified, scored by the models of a folder: as faces, as backs.

    As backs those that look more like one than like a face.
    """
    settings, _ = load_settings("default", None, [], {"models.folder": str(folder)})
    models = load_models(settings)
    if models.box_classifier is None or models.detection_network is None:
        raise InputError(f"{folder}: wanted a box classifier and a detection network")
    back = models.back_classifier
    asked = replace(
        models,
        box_classifier=replace(models.box_classifier, with_network=None),
        back_classifier=None if back is None else replace(back, threshold=-np.inf),
    )
    seen, behind = views_by_frame(read_truth(log.with_suffix(".truth.json")))
    frames = (f for f in read_frames(log, LEARN_READ, ReadReport()) if f.index % EVERY == 0)
    faces: list[ScoredBoxes] = []
    backs: list[ScoredBoxes] = []
    for item in Flow(settings, asked, StageClock()).detect(frames):
        network, candidates = item.segmentation.network_score, item.candidates
        if network is None:
            continue
        rows = np.flatnonzero(np.isfinite(candidates.score))
        score = np.stack([candidates.score[rows], network[rows]], axis=1)
        faces.append(_scored(candidates, rows, score, seen.get(item.frame.index, [])))
        if candidates.back_score is not None:
            rows = np.flatnonzero(np.isfinite(candidates.back_score))
            score = candidates.back_score[rows, None]
            backs.append(_scored(candidates, rows, score, behind.get(item.frame.index, [])))
    return faces, backs


def _scored(
    candidates: Candidates, rows: NDArray[np.int64], score: NDArray[np.float32], views: SignViews
) -> ScoredBoxes:
    """Some candidates of an image with their scores (rows, k), labelled by the panels that it shows."""
    regions = candidates.regions.select(rows)
    panels = TrueFaces.of([views], [True])
    known = labelled(regions, np.zeros(len(rows), np.int32), panels)
    return ScoredBoxes(regions.box, score, known.label, known.overlap)


def learn(logs: Sequence[Path], folder: Path) -> dict[str, TreeModel]:
    """The classifiers of a folder with their thresholds by the rule on these drives, by the name of their file.

    Raises
    ------
    InputError
        If a drive or the models of the folder cannot be used.
    """
    settings, _ = load_settings("default", None, [], {"models.folder": str(folder)})
    models = load_models(settings)
    model, back = models.box_classifier, models.back_classifier
    if not isinstance(model, TreeModel):
        raise InputError(f"{folder}: wanted a box classifier, found none")
    found = for_each(lambda log: scored_boxes(log, folder), logs)
    faces, backs = [drive[0] for drive in found], [drive[1] for drive in found]
    drives = f"{sum(map(len, faces))} images of {len(logs)} drives"
    max_iou = settings.candidates.same_face_iou
    joined, interval = learn_network_sum(faces, model.threshold, max_iou)
    known = model.provenance.partition("; joined with the network by ")[0]
    learned = {
        "judge.json": replace(
            model,
            with_network=joined,
            threshold_rule=false_boxes_rule(FALSE_FACES),
            threshold_interval=interval,
            provenance=f"{known}; joined with the network by {drives}",
        )
    }
    if isinstance(back, TreeModel):
        threshold, interval = rule_threshold(backs, np.ones(1), FALSE_BACKS, max_iou)
        known = back.provenance.partition("; threshold by ")[0]
        learned["back.json"] = replace(
            back,
            threshold=threshold,
            threshold_rule=false_boxes_rule(FALSE_BACKS),
            threshold_interval=interval,
            provenance=f"{known}; threshold by {drives}",
        )
    return learned


def main(arguments: list[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m wayside.pipeline.learning.box_thresholds")
    parser.add_argument("--drives", type=Path, required=True, help="folder of rendered drives")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the model files")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    try:
        for name, model in learn(learning_logs(given.drives), given.out).items():
            write_model(given.out / name, model, lambda text: print(text[-300:]))
            print(name, model.threshold, model.threshold_interval, model.with_network)
    except WaysideError as error:
        print(f"wayside: {error}", file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
