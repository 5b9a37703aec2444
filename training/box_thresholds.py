"""Thresholds of the box network's scores, and how the scores of faces are joined with the detection network's.

    python -m training.box_thresholds --drives FOLDER -o MODELS

A logistic regression on the boxes that are classified, on rendered drives that no model of one image has learned from,
joins the scores of faces. The rule of each threshold is a number of boxes an image on no panel of its side, on these
drives. The sum is shifted to have the same threshold as the box network alone. Writes `front.json` and `back.json`.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from training import truth
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.learning.fits import logistic
from wayside.pipeline.learning.labelled import NEAR_FACE, NEITHER, ON
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.running.flow import Flow
from wayside.pipeline.statistics import Interval, resampled_interval
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError
from wayside.schemas.models import NetworkSum, ScoreModel
from wayside.stages.detection import SAME_FACE_IOU
from wayside.stages.geometry import non_maximum_suppression
from wayside.stages.kernels import Array, Flags, Floats, Numbers

THREADS = 2
"""How many drives are read at a time."""

EVERY = 4
"""Every n-th image of a drive: three numbers are learned."""

LOWEST = -100.0
"""Log odds below all that a box has."""

FALSE_FACES, FALSE_BACKS = 5.0, 1.0
"""Boxes off any panel, after suppression, that pass in an image: the landmark classifier decides on them."""

BELOW_THRESHOLD = 4.0
"""Boxes whose log odds by the box network are farther below its threshold are out of reach of the detection network."""


@dataclass(frozen=True, slots=True)
class ScoredBoxes:
    """Boxes of one image, n rows, as what they may be: faces, or backs of panels.

    `box`: (n, 4). `score` (n, 2) by box and detection network, of backs (n, 1). `label`, `overlap` (n,) with a panel.
    """

    box: Floats
    score: Floats
    label: NDArray[np.int8]
    overlap: NDArray[np.floating]


def learn_network_sum(
    drives: Sequence[Sequence[ScoredBoxes]], threshold: float
) -> tuple[NetworkSum, Interval | None]:
    """The sum that is a log odds, but for a shift by which it has the `threshold` of the box network alone.

    `drives`: images of each. With it the 95 % interval of the threshold.
    Raises InputError without boxes on faces, or off them.
    """
    images = [one for drive in drives for one in drive]
    score = np.concatenate([one.score for one in images])
    label = np.concatenate([one.label for one in images])
    some = (label != NEITHER) & (score[:, 0] >= threshold - BELOW_THRESHOLD)
    on = label[some] == ON
    if on.all() or not on.any():
        raise InputError(
            "scores: boxes on faces and off them are needed, but all are of one kind. Add drives."
        )
    (own, network), _ = platt(score[some], on)
    at, interval = rule_threshold(drives, np.array([own, network]), FALSE_FACES)
    shift = threshold - at
    if interval is not None:
        interval = Interval(interval.low + shift, interval.high + shift)
    return NetworkSum(float(own), float(network), float(shift)), interval


def rule_threshold(
    drives: Sequence[Sequence[ScoredBoxes]], weights: Array, accepted: float
) -> tuple[float, Interval | None]:
    """The weighted score from which `accepted` boxes an image are on no panel, after suppression.

    With its 95 % interval by resampling the drives; None of a single one.
    """
    false = [
        np.concatenate([false_scores(one, one.score @ weights) for one in drive])
        for drive in drives
    ]
    images = np.array([len(drive) for drive in drives])
    drive_of = np.repeat(np.arange(len(drives)), [len(one) for one in false])
    falling = np.argsort(-np.concatenate(false), kind="stable")
    scores, drive_of = np.concatenate(false)[falling], drive_of[falling]

    def at(times: Numbers) -> float:
        """The threshold with each drive counted as often as given: between the last that passes and the next."""
        allowed = round(accepted * int(images @ times))
        row = int(np.searchsorted(np.cumsum(times[drive_of]), allowed, side="right"))
        last, following = scores[max(row - 1, 0)], scores[min(row, len(scores) - 1)]
        return float((last + following) / 2)

    return at(np.ones(len(drives), np.int64)), resampled_interval(len(drives), at)


def false_scores(one: ScoredBoxes, score: NDArray[np.floating]) -> NDArray[np.floating]:
    """Scores of the boxes of an image that are on no panel, after suppression by `score` (n,), as in detection."""
    order = np.argsort(-score, kind="stable")
    kept = order[non_maximum_suppression(one.box[order], SAME_FACE_IOU)]
    return score[kept][one.overlap[kept] < NEAR_FACE]


def false_boxes_rule(accepted: float) -> str:
    """The rule of a threshold that lets so many boxes an image pass, in words."""
    return (
        f"alpha: {accepted:g} boxes off any face in an image of drives held out, after suppression"
    )


def scored_boxes(log: Path, folder: Path) -> tuple[list[ScoredBoxes], list[ScoredBoxes]]:
    """The boxes of a rendered drive that are classified, scored by the networks of a folder: as faces, as backs.

    As backs those that look more like one than like a face.
    """
    settings, _ = load_settings("default", None, [], {"models.folder": str(folder)})
    models = load_models(settings)
    asked = replace(
        models,
        front_scores=ScoreModel(LOWEST, ""),
        back_scores=ScoreModel(LOWEST, ""),
    )
    views = truth.views_by_frame(truth.read_truth(log))
    faces: list[ScoredBoxes] = []
    backs: list[ScoredBoxes] = []
    for item in Flow(settings, asked, StageClock()).detect(truth.frames_of(log, EVERY)):
        network, candidates = item.segmentation.network_score, item.candidates
        if network is None or candidates.back_score is None:
            continue
        here = views.get(item.frame.index, [])
        rows = np.flatnonzero(np.isfinite(candidates.score))
        score = np.stack([candidates.score[rows], network[rows]], axis=1)
        facing = [view for view in here if view.sign["faces_travel"]]
        box = candidates.regions.box
        faces.append(ScoredBoxes(box[rows], score, *truth.box_labels(box[rows], facing)))
        rows = candidates.back_rows()
        score = candidates.back_score[rows, None]
        behind = [view for view in here if view.back]
        backs.append(ScoredBoxes(box[rows], score, *truth.box_labels(box[rows], behind)))
    return faces, backs


def learn(drives: Path, out: Path) -> None:
    """Write the thresholds for the networks of a folder by the rule on the drives of another.

    Raises InputError if a drive or the networks of the folder cannot be used.
    """
    logs = truth.learning_logs(drives)
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(lambda log: scored_boxes(log, out), logs))
    faces, backs = [drive[0] for drive in found], [drive[1] for drive in found]
    provenance = "thresholds by " + ", ".join(
        f"{log.stem} ({len(own)} images)" for log, own in zip(logs, faces, strict=True)
    )
    threshold, _ = rule_threshold(faces, np.array([1.0, 0.0]), FALSE_FACES)
    joined, interval = learn_network_sum(faces, threshold)
    front = ScoreModel(threshold, provenance, joined, false_boxes_rule(FALSE_FACES), interval)
    threshold, interval = rule_threshold(backs, np.ones(1), FALSE_BACKS)
    back = ScoreModel(threshold, provenance, None, false_boxes_rule(FALSE_BACKS), interval)
    truth.write_model(out / "front.json", front)
    truth.write_model(out / "back.json", back)


def platt(scores: NDArray[np.floating[Any]], positive: Flags) -> tuple[Array, float]:
    """Slopes (k,) and shift that make one log odds of k scores (n, k), by Platt's softened targets."""
    count, rest = positive.sum(), (~positive).sum()
    target = np.where(positive, (count + 1) / (count + 2), 1 / (rest + 2))
    start = np.append(np.full(scores.shape[1], 1 / scores.shape[1]), 0.0)
    found = logistic(np.asarray(scores, np.float64), target, start, np.zeros(len(start)))
    return found[:-1], float(found[-1])


main = truth.command(__doc__, learn, drives=truth.DRIVES, out=truth.OUT)

if __name__ == "__main__":
    sys.exit(main())
