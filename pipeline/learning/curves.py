"""True and false positive rates of a classifier over its thresholds: area, knee and confidence bands (chapter 10).

A rate is of counted samples: TPR = TP / (TP + FN) (eq. 10.1), FPR = FP / (FP + TN) (eq. 10.2). Bands resample whole
drives, or stretches of one drive where there is no other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.asked import NO_CLASS, ClassifierSamples
from wayside.pipeline.learning.labelled import ON
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.statistics import TAILS, Interval, resamplings
from wayside.schemas.models import EvidenceModel
from wayside.schemas.settings import Settings
from wayside.stages.classifiers import class_distances

KNEE_RULE = "knee of the ROC: largest true minus false positive rate (report chapter 10)"
STRETCH_FRAMES = 10
"""Frames of a stretch of a drive that is resampled where there is no second drive."""
MOST_THRESHOLDS = 400
"""Thresholds of a curve: quantiles of its values where there are more."""
ALL = "all"
"""Class of a classifier as a whole."""


@dataclass(frozen=True, slots=True)
class Scores:
    """Values of n samples of a classifier for one class: `accept_below`, small ones are signs, else large ones.

    `value` (n,) float64. `on` (n,) bool: whether it is a sign of the class. `count` (n,) int64 samples that a row
    stands for. `group` (n,) int64: number of the drive, or of the stretch of one drive.
    """

    value: NDArray[np.float64]
    on: NDArray[np.bool_]
    count: NDArray[np.int64]
    group: NDArray[np.int64]
    accept_below: bool

    @property
    def likeness(self) -> NDArray[np.float64]:
        """The values (n,) with such a sign that larger ones are more like a sign; -inf where unknown."""
        turned = -self.value if self.accept_below else self.value
        return np.where(np.isfinite(turned), turned, -np.inf)

    def within(self, threshold: float) -> NDArray[np.bool_]:
        """Whether each value (n,) is accepted at a threshold."""
        return self.value <= threshold if self.accept_below else self.value >= threshold


@dataclass(frozen=True, slots=True)
class RocCurve:
    """Rates (k,) at thresholds from the strictest to the one that accepts everything, with 95 % bands (k, 2).

    `threshold` (k,): in the unit of the values; the first accepts nothing. `tp`, `fp` (k,): counts. `positives`,
    `negatives`: of all. `knee`: row of the largest TPR - FPR. `area`: under the curve, which is the probability that a
    sign is more like one than something else. `knee_interval`: of the threshold at the knee. `groups`: how many drives
    or stretches are resampled; where signs or others are in one only, bands and intervals are None.
    """

    threshold: NDArray[np.float64]
    tp: NDArray[np.int64]
    fp: NDArray[np.int64]
    positives: int
    negatives: int
    area: float
    knee: int
    groups: int
    tpr_band: NDArray[np.float64] | None = None
    fpr_band: NDArray[np.float64] | None = None
    area_interval: Interval | None = None
    knee_interval: Interval | None = None

    @property
    def tpr(self) -> NDArray[np.float64]:
        """True positive rate (k,), eq. 10.1."""
        return self.tp / self.positives

    @property
    def fpr(self) -> NDArray[np.float64]:
        """False positive rate (k,), eq. 10.2."""
        return self.fp / self.negatives

    def at(self, threshold: float, *, accept_below: bool) -> int:
        """Row of the loosest threshold of the curve that is no looser than this one."""
        looser = self.threshold > threshold if accept_below else self.threshold < threshold
        return int(np.argmax(looser)) - 1 if looser.any() else len(looser) - 1


def roc_curve(scores: Scores) -> RocCurve | None:
    """The curve of a classifier; None where there is no sign, or nothing else."""
    positives = int(scores.count[scores.on].sum())
    negatives = int(scores.count[~scores.on].sum())
    if not positives or not negatives:
        return None
    likeness = scores.likeness
    cuts = np.unique(likeness[np.isfinite(likeness)])
    if len(cuts) > MOST_THRESHOLDS:
        cuts = cuts[np.linspace(0, len(cuts) - 1, MOST_THRESHOLDS).round().astype(int)]
    # least accepted likeness, from inf, which accepts nothing
    cuts = np.append(np.inf, cuts[::-1])
    threshold = -cuts if scores.accept_below else cuts
    groups, group = np.unique(scores.group, return_inverse=True)
    row = np.searchsorted(-cuts, -likeness, side="left")  # strictest cut that accepts it
    accepted = np.zeros((2, len(groups), len(cuts) + 1))
    np.add.at(accepted, (scores.on.astype(int), group, row), scores.count)
    every = accepted.sum(axis=2)
    accepted = accepted.cumsum(axis=2)[:, :, : len(cuts)]
    fp, tp = accepted.sum(axis=1).astype(np.int64)
    tpr, fpr = tp / positives, fp / negatives
    return RocCurve(
        threshold,
        tp,
        fp,
        positives,
        negatives,
        float(area_under(fpr, tpr)),
        int(np.argmax(tpr - fpr)),
        len(groups),
        *(_bands(accepted, every, threshold) if min((every > 0).sum(axis=1)) > 1 else ()),
    )


def _bands(
    accepted: NDArray[np.float64],
    every: NDArray[np.float64],
    threshold: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], Interval, Interval | None]:
    """Bands of both rates, intervals of area and knee; by others and signs accepted, (2, groups, k), of (2, groups)."""
    weight = resamplings(every.shape[1])
    totals = np.stack([weight @ every[kind] for kind in (0, 1)])
    usable = (totals > 0).all(axis=0)  # a resampling may have no sign, or nothing else
    rates = np.stack(
        [(weight[usable] @ accepted[kind]) / totals[kind, usable, None] for kind in (0, 1)]
    )
    fpr_band, tpr_band = np.quantile(rates, TAILS, axis=1).transpose(1, 2, 0)
    area = Interval(*np.quantile(area_under(*rates), TAILS).tolist())
    knees = threshold[np.argmax(rates[1] - rates[0], axis=1)]
    knees = knees[np.isfinite(knees)]
    ends = np.quantile(knees, TAILS, method="nearest").tolist() if len(knees) else None
    return tpr_band, fpr_band, area, None if ends is None else Interval(*ends)


def area_under(fpr: NDArray[np.float64], tpr: NDArray[np.float64]) -> NDArray[np.float64]:
    """Area (...) under curves of rates (..., k) by trapezia, the last point joined with (1, 1): ties count half."""
    area = np.asarray(np.trapezoid(tpr, fpr, axis=-1))
    return area + (1 - fpr[..., -1]) * (1 + tpr[..., -1]) / 2


def resampled_groups(
    drive: NDArray[np.str_], frame: NDArray[np.int32]
) -> tuple[NDArray[np.int64], str]:
    """Number of the group (n,) that each sample is resampled with, and what a group is: `drive`, or `stretch`."""
    names, group = np.unique(drive, return_inverse=True)
    if len(names) > 1:
        return group.astype(np.int64), "drive"
    return frame.astype(np.int64) // STRETCH_FRAMES, "stretch"


@dataclass(frozen=True, slots=True)
class Question:
    """A classifier's test for one class.

    `threshold`: that of the run, or nan. `unit`: of its values. `resampled`: what the groups of the scores are.
    """

    classifier: str
    name: str
    scores: Scores
    threshold: float
    unit: str
    resampled: str

    def used_row(self, curve: RocCurve) -> int | None:
        """Row of its curve at the threshold of the run."""
        if np.isnan(self.threshold):
            return None
        return curve.at(self.threshold, accept_below=self.scores.accept_below)


def questions(
    samples: Mapping[str, ClassifierSamples], settings: Settings, models: Models
) -> Iterator[Question]:
    """Every test of the classifiers that were asked, in the order of the chain.

    A class of colour or shape is tested with its own signs against what is no sign; signs of other classes count in the
    confusion. A landmark is tested by the sum of its evidence (`all`) and by each term alone. A place has no class: a
    sign belongs to the component of the model that it is nearest to. `all` is a classifier of several classes as a
    whole: the least distance over threshold, which it accepts up to 1.
    """
    for classifier, every in samples.items():
        yield from _questions_of(classifier, every.known(), settings, models)


def _questions_of(
    classifier: str, own: ClassifierSamples, settings: Settings, models: Models
) -> Iterator[Question]:
    group, resampled = resampled_groups(own.drive, own.frame)
    on, everything = own.label == ON, np.ones(len(own), np.bool_)
    value, gate = own.values[:, 0], settings.gate

    def question(
        name: str,
        value: NDArray[np.float64],
        threshold: float,
        unit: str,
        rows: NDArray[np.bool_] = everything,
        *,
        below: bool = False,
    ) -> Question:
        scores = Scores(value[rows], on[rows], own.count[rows], group[rows], below)
        return Question(classifier, name, scores, threshold, unit, resampled)

    model = {
        "color": models.color_classes,
        "shape": models.shape_classes,
        "location": models.location_classes,
    }.get(classifier)
    if classifier == "size":
        yield question("smallest", value, gate.smallest_px, "px")
        yield question("largest", value, gate.largest_px, "px", below=True)
    elif model is not None:
        distance = class_distances(own.values, model)
        thresholds = np.array([one.threshold for one in model.classes])
        whole = (distance / np.maximum(thresholds, 1e-9)).min(axis=1)
        yield question(ALL, whole, 1.0, "thresholds", below=True)
        nearest = np.where(np.isfinite(distance), distance, np.inf).argmin(axis=1)
        has_classes = bool((own.kind != NO_CLASS).any())
        for j, one in enumerate(model.classes):
            rows = ~on | (own.kind == one.name) if has_classes else nearest == j
            unit = "Mahalanobis distance"
            yield question(one.name, distance[:, j], one.threshold, unit, rows, below=True)
    elif classifier == "confidence":
        least = models.sign_confidence(settings.locate.confidence)
        yield question(ALL, value, least, "probability")
    else:
        learned, unit = {
            "detector": (models.front_scores, "log odds"),
            "landmark": (models.landmark_classifier, "log odds"),
            "trajectory": (models.trajectory_density, "mean log density"),
        }[classifier]
        yield question(ALL, value, np.nan if learned is None else learned.threshold, unit)
        # no term decides by itself
        terms = dict.fromkeys(learned.terms) if isinstance(learned, EvidenceModel) else ()
        for column, term in enumerate(terms, 1):
            yield question(term, own.values[:, column], np.nan, "log-likelihood ratio")
