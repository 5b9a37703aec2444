"""Learn the landmark classifiers from drives: `python -m training.learn_landmarks`.

The drives are others than those of `learn.py`: on images that a detector has learned from, its scores are higher than
on the road.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from training.detector_images import checked_boxes
from training.truth import (
    DRIVES,
    LEARN_READ,
    OUT,
    KnownPanels,
    command,
    folder,
    learning_logs,
    processes,
    read_truth,
    write_model,
)
from wayside.pipeline.detectors import detector_of
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.learning.labelled import NEITHER, ON
from wayside.pipeline.learning.thresholds import normal_tail, rates_of, score_points
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.flow import Flow
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError
from wayside.schemas.models import EvidenceModel
from wayside.schemas.settings import ReadSettings, TrackSettings
from wayside.stages.mapping import FEATURES, PanelModels, track
from wayside.stages.odometry import estimate_motion

FOR, AGAINST = 1, -1
EVIDENCE: tuple[tuple[str, str, int, tuple[float, ...]], ...] = (
    ("score_best", "appearance", FOR, (-2, 0, 2, 4, 6, 8, 12)),
    ("log_views", "views", FOR, (0.7, 1.4, 2.1, 2.9)),
    ("missed", "views", AGAINST, (0, 0.15, 0.4, 0.8)),
    ("log_side", "size", FOR, (-2, -1.2, -0.7, 0)),
    ("oversize", "size", AGAINST, (0, 0.4, 1, 2)),
    ("log_place", "place", FOR, (-12, -9, -7, -6, -5, -4, -3)),
    ("size_scatter", "rigidity", AGAINST, (0, 0.1, 0.2, 0.35)),
    ("depth_sigma", "rigidity", AGAINST, (0, 0.03, 0.1, 0.4)),
    ("surroundings", "surroundings", AGAINST, (-0.3, 0.2, 0.5, 1)),
)
"""Feature, term, the direction in which it may count, and the knots of its curve, over what landmarks show: what is
known from the nature of a sign is not left to a few examples."""
RIDGE, ROUGHNESS = 1.0, 1.0
"""Penalties on the squared slopes of a curve, a third of the range of its knots as unit, and on their differences from
one segment to the next: a curve bends where the examples ask for it, and is straight elsewhere."""
REAL_WEIGHT, RENDERED_SHARE = 200.0, 0.5
"""Weight of all real landmarks together, and that of the rendered ones as a share of it: they fill what real ones lack,
and never outweigh them. Without real ones they weigh as much as real ones would."""
UNCERTAIN = float(np.log(1 / 3))
"""Log odds down to which a face is uncertain, not refused, and a back is one: one in four is a sign."""
PRIOR = float(np.log(3 / 7))
"""Log odds of a landmark before any evidence: of 393 that nine real drives gave, 116 were signs."""
FOLDS = 8
FEWEST_EXAMPLES = 16
RULE = "log odds of 0: as likely a sign as anything else, where three landmarks in ten are signs"
Values = NDArray[np.float64]


SAMPLE = np.dtype(
    [
        ("values", np.float32, len(FEATURES)),
        ("label", np.int8),
        ("back", np.bool_),
        ("usual", np.bool_),
        ("drive", np.int64),
        ("source", "U16"),
    ]
)
"""A landmark of a drive with truth: its features and label; whether it was followed as the back of a panel; whether its
boxes were accepted by the threshold that runs have; number of the drive; what this is left out together with, "" where
it was rendered."""

Samples = np.recarray[Any, Any]
Row = tuple[Sequence[float], int, bool, bool]
"""The first four of `SAMPLE`."""


def samples_of(drives: Sequence[tuple[str, Sequence[Row]]]) -> Samples:
    """The landmarks of several drives, each with its source, in one table; drives are numbered in this order."""
    rows = [(*row, number, source) for number, (source, own) in enumerate(drives) for row in own]
    return np.array(rows, SAMPLE).view(np.recarray)


def learn_landmark_classifier(samples: Samples, provenance: str) -> EvidenceModel:
    """Fit the curves of all terms together. Operating points are computed on drives held out in turn.

    Logistic regression on the segments of the curves weighs terms that depend on each other (views of one board) by
    what they say together. Signs and others weigh the same in it, and `PRIOR` says how many are signs. Real drives are
    held out by source, rendered ones by drive; the points are of real ones, as runs see them, if there are enough.
    Raises InputError where there are too few landmarks of either kind.
    """
    own = samples[samples.label != NEITHER]
    sign = own.label == ON
    if min(sign.sum(), (~sign).sum()) < FEWEST_EXAMPLES or len(np.unique(own.drive)) < 2:
        raise InputError(
            f"landmark classifier: two drives and {FEWEST_EXAMPLES} landmarks of either kind are needed. There are "
            f"{len(np.unique(own.drive))} drives, {sign.sum()} signs and {(~sign).sum()} others. Add drives."
        )
    columns, weight = _segments(own.values), _weights(own, sign)
    held_out = np.empty(len(sign))
    folds = np.where(own.source == "", (own.drive % FOLDS).astype(str), own.source)
    for fold in np.unique(folds):
        held = folds == fold
        slopes = _logistic_regression(columns[~held], sign[~held], weight[~held])
        held_out[held] = columns[held] @ slopes[:-1] + slopes[-1]
    judged = (own.source != "") & own.usual
    if min((judged & sign).sum(), (judged & ~sign).sum()) < FEWEST_EXAMPLES:
        judged = np.ones(len(sign), np.bool_)
    points = score_points(
        held_out[judged] + PRIOR,
        sign[judged],
        own.drive[judged],
        normal_tail,
        rates_of(int((judged & ~sign).sum())),
    )
    slopes = _logistic_regression(columns, sign, weight)
    curves, constant = [], float(slopes[-1]) + PRIOR
    steps = np.split(slopes[:-1], np.cumsum([len(k) - 1 for *_, k in EVIDENCE])[:-1])
    for (name, _, direction, knots), rise in zip(EVIDENCE, steps, strict=True):
        curve = np.concatenate([[0.0], np.cumsum(direction * rise * np.diff(knots))])
        # a term of 0 says nothing: half-way between what signs and others have
        seen = np.interp(own.values[:, FEATURES.index(name)], knots, curve)
        middle = float(np.nanmean(seen[sign]) + np.nanmean(seen[~sign])) / 2
        curves.append(_rounded(curve - middle))
        constant += middle
    names, terms, _, knots_of = zip(*EVIDENCE, strict=True)
    return EvidenceModel(
        names,
        terms,
        tuple(np.array(knots, np.float64) for knots in knots_of),
        tuple(curves),
        shift=round(constant, 5),
        threshold=UNCERTAIN,
        provenance=provenance,
        threshold_rule=RULE,
        curve=points,
    )


def _segments(values: NDArray[np.float32]) -> Values:
    """How far the features (n, f) reach into each segment of their curves (n, s), in its direction; nan: the mean."""
    columns = []
    for name, _, direction, knots in EVIDENCE:
        value = values[:, FEATURES.index(name)].astype(np.float64)
        value = np.where(np.isnan(value), np.nanmean(value) if (value == value).any() else 0, value)
        for low, high in pairwise(knots):
            columns.append(direction * (np.clip(value, low, high) - low))
    return np.column_stack(columns)


def _weights(samples: Samples, sign: NDArray[np.bool_]) -> Values:
    """Weights (n,): signs and others alike; a real source by the root of its number, the rendered ones by theirs."""
    weight, real = np.zeros(len(sign)), samples.source != ""
    for source in np.unique(samples.source):
        for kind in (sign, ~sign):
            own = (samples.source == source) & kind
            weight[own] = 1 / np.sqrt(max(own.sum(), 1))
    for rows, share in ((real, 1.0), (~real, RENDERED_SHARE if real.any() else 1.0)):
        for kind in (sign, ~sign):
            own = rows & kind
            weight[own] *= share * REAL_WEIGHT / 2 / max(weight[own].sum(), 1e-9)
    return weight


def _rounded(values: Values) -> Values:
    """To the six digits that the file has."""
    return np.array([float(f"{value:.6g}") for value in values])


def _logistic_regression(columns: Values, sign: NDArray[np.bool_], weight: Values) -> Values:
    """Slopes (s,) of all segments, none of them negative, and a constant, by samples that weigh (n,)."""
    unit = np.concatenate([np.full(len(k) - 1, (k[-1] - k[0]) / 3) for *_, k in EVIDENCE])
    penalty = np.zeros((len(unit) + 1, len(unit) + 1))
    start = 0
    for *_, knots in EVIDENCE:
        own = slice(start, start + len(knots) - 1)
        bend = np.diff(np.eye(len(knots) - 1), axis=0)
        penalty[own, own] = RIDGE / (len(knots) - 1) * np.eye(len(knots) - 1)
        penalty[own, own] += ROUGHNESS * bend.T @ bend
        start = own.stop
    inputs = np.column_stack([columns / unit, np.ones(len(columns))])
    target = np.where(sign, 1.0, -1.0)

    def cost(slopes: Values) -> tuple[float, Values]:
        margin, pull = target * (inputs @ slopes), penalty @ slopes
        gradient = inputs.T @ (-target * weight * expit(-margin)) + pull
        return float(weight @ np.logaddexp(0.0, -margin) + 0.5 * slopes @ pull), gradient

    bounds = [(0.0, None)] * len(unit) + [(None, None)]
    found = minimize(cost, np.zeros(len(unit) + 1), jac=True, bounds=bounds, method="L-BFGS-B")
    return np.append(found.x[:-1] / unit, found.x[-1])


LENIENT = (0.0, 1.0, 2.0)
"""Log odds by which the threshold of faces is lowered: else few landmarks are no signs."""

FEWEST = 2
"""Landmarks of fewer views than are reported are learned from, too: there are more, and the number is a feature."""

PROCESSES = 2
"""How many drives are run at a time."""

REAL_DRIVES = {"ca_city_garmin": ("garmin", 0.0), "us_freeway_yellow_left": ("udacity", 5.9)}
"""Real drives to learn from, each with networks that have not learned from it: source, and distance between images
where the log states none, metres."""


def learn_landmarks(
    drives: Path, out: Path, real: Path | None = None, without: Path | None = None
) -> None:
    """Learn `place.json` and `back_place.json` from the drives of a folder.

    `out`: the models that the drives are tracked with; what is learned is written there. `real`: folder of the
    `REAL_DRIVES`. `without`: folder of models, in folders named after the real drive that they have not learned from. A
    drive that `out` is named after is left out. Raises InputError if drives are missing, cannot be used or show too
    few landmarks, OutputError if a file cannot be written.
    """
    logs = learning_logs(drives)
    tasks = [
        (out, log, KnownPanels.of(read_truth(log)), LEARN_READ) for log in logs
    ]  # or processes are started for nothing
    sources = [""] * len(logs)
    for name, (source, spacing_m) in REAL_DRIVES.items():
        if real is not None and name != out.name:
            log = real / f"{name}.mcap"
            labels = json.loads(log.with_suffix(".labels.json").read_text(encoding="utf-8"))
            known = KnownPanels.of_labels(labels, checked_boxes(name))
            own = out if without is None or not (without / name).is_dir() else without / name
            read = replace(LEARN_READ, spacing_m=spacing_m)
            tasks.append((own, log, known, read))
            sources.append(source)
    with processes(PROCESSES) as pool:
        found = pool.map(_landmarks_of, *zip(*tasks, strict=True))
        samples = samples_of(list(zip(sources, found, strict=True)))
    for name, back in (("place.json", False), ("back_place.json", True)):
        side = samples[samples.back == back]
        origin = provenance([log.stem for _, log, *_ in tasks], side)
        try:
            model = learn_landmark_classifier(side, origin)
        except InputError as error:
            print(f"{name} not written, such landmarks are classified by their fit alone: {error}")
        else:
            write_model(out / name, model)


def provenance(names: list[str], samples: Samples) -> str:
    """What a model was learned from: drives by name, with the number of landmarks of each."""
    counts = [int((samples.drive == number).sum()) for number in range(len(names))]
    listed = ", ".join(f"{n} ({count} landmarks)" for n, count in zip(names, counts, strict=True))
    return f"drives {listed}; the name of a rendered one ends in what was added to the seed of its specification"


def _landmarks_of(folder: Path, log: Path, known: KnownPanels, read: ReadSettings) -> list[Row]:
    """The landmarks of a drive by the models of a folder, once for each threshold of faces."""
    settings, _ = load_settings("default", None, [], {"models.folder": str(folder)})
    models, rows = load_models(settings), list[Row]()
    if models.front_scores is None:
        raise InputError(f"{folder}: there are no thresholds of the box network")
    for lower in LENIENT:
        scores = replace(models.front_scores, threshold=models.front_scores.threshold - lower)
        # without landmark classifiers, everything that stands is followed to its end
        own = replace(
            models, front_scores=scores, landmark_classifier=None, back_landmark_classifier=None
        )
        found = Flow(settings, own, StageClock()).detect(read_frames(log, read, ReadReport()))
        moved = estimate_motion(found, settings.motion)
        detector = detector_of(settings, own)
        settled = TrackSettings(fewest_views=FEWEST)
        panel = PanelModels(own.outline_weights)
        tracked = track(moved, settled, detector.front, detector.back, panel)
        rows += [
            (one.features, known.label(one), one.back, lower == 0)
            for frame in tracked
            for one in frame.landmarks
        ]
    return rows


main = command(
    __doc__,
    learn_landmarks,
    drives=DRIVES,
    out=OUT,
    real=folder("--real", "real drives", required=False),
    without=folder("--without", "models without a real drive", required=False),
)

if __name__ == "__main__":
    sys.exit(main())
