"""True and false positive rates of a classifier over its thresholds: area, knee and confidence bands (chapter 10).

A rate is of counted samples: TPR = TP / (TP + FN) (eq. 10.1), FPR = FP / (FP + TN) (eq. 10.2). Bands resample whole
drives, or stretches of one drive where there is no other.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.asked import NO_CLASS, ClassifierSamples
from wayside.pipeline.learning.labelled import ON
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.statistics import TAILS, Interval, resamplings
from wayside.schemas.models import EvidenceModel
from wayside.schemas.settings import Settings
from wayside.stages.classifiers import log_ratios
from wayside.stages.kernels import Array, Flags, Numbers

STRETCH_FRAMES = 10
"""Frames of a stretch of a drive that is resampled where there is no second drive."""
ALL = "all"
"""Class of a classifier as a whole."""


class Bands(NamedTuple):
    """95 % bands of both rates (k, 2), and intervals of the area and of the threshold at the knee; None if unknown."""

    tpr: Array | None = None
    fpr: Array | None = None
    area: Interval | None = None
    knee: Interval | None = None


@dataclass(frozen=True)
class RocCurve:
    """A test for one class: n samples, and its rates at k thresholds, which exist where it is `two_sided`.

    Between two thresholds that follow each other the accepted signs stay the same, but for signs and others of one
    value: straight lines between the thresholds are the curve.

    `value` (n,) float64: small ones are signs if `accept_below`, else large ones. `on` (n,) bool: whether it is a sign
    of the class. `count` (n,) int64 samples that a row stands for. `group` (n,) int64: number of what is resampled
    together, a drive or a stretch of one (`resampled`). `used`: threshold of the run, or nan. `unit`: of the values.
    """

    value: Array
    on: Flags
    count: Numbers
    group: Numbers
    accept_below: bool
    classifier: str = ""
    name: str = ALL
    used: float = np.nan
    unit: str = ""
    resampled: str = ""

    @property
    def likeness(self) -> Array:
        """The values (n,) with such a sign that larger ones are more like a sign; -inf where unknown."""
        turned = -self.value if self.accept_below else self.value
        return np.where(np.isfinite(turned), turned, -np.inf)

    def within(self, threshold: float) -> Flags:
        """Whether each value (n,) is accepted at a threshold."""
        return self.value <= threshold if self.accept_below else self.value >= threshold

    @cached_property
    def threshold(self) -> Array:
        """Thresholds (k,) from the strictest, which accepts nothing, to the one that accepts all known values.

        Every value of a sign, the next stricter value, and the threshold of the run.
        """
        likeness = self.likeness
        known = np.isfinite(likeness)
        cuts, signs = np.unique(likeness[known]), np.unique(likeness[known & self.on])
        stricter = np.append(cuts, np.inf)[np.searchsorted(cuts, signs) + 1]
        used = -self.used if self.accept_below else self.used
        kept = np.concatenate([cuts[:1], signs, stricter, [used]])
        cuts = np.append(np.inf, np.unique(kept[np.isfinite(kept)])[::-1])
        return -cuts if self.accept_below else cuts

    @cached_property
    def accepted(self) -> Array:
        """How many others and signs of each group each threshold accepts, (2, groups, k + 1); the last has all."""
        groups, group = np.unique(self.group, return_inverse=True)
        cuts = self.threshold if self.accept_below else -self.threshold
        row = np.searchsorted(cuts, -self.likeness, side="left")  # strictest that accepts it
        counts = np.zeros((2, len(groups), len(cuts) + 1))
        np.add.at(counts, (self.on.astype(int), group, row), self.count)
        return counts.cumsum(axis=2)

    @property
    def positives(self) -> int:
        """How many signs there are."""
        return int(self.count[self.on].sum())

    @property
    def negatives(self) -> int:
        """How many other things there are."""
        return int(self.count[~self.on].sum())

    @property
    def two_sided(self) -> bool:
        """Whether there are signs and other things."""
        return self.positives > 0 and self.negatives > 0

    @cached_property
    def tp(self) -> Numbers:
        """Signs (k,) that are accepted."""
        return np.asarray(self.accepted[1, :, :-1].sum(axis=0), np.int64)

    @cached_property
    def fp(self) -> Numbers:
        """Other things (k,) that are accepted."""
        return np.asarray(self.accepted[0, :, :-1].sum(axis=0), np.int64)

    @property
    def tpr(self) -> Array:
        """True positive rate (k,), eq. 10.1."""
        return self.tp / self.positives

    @property
    def fpr(self) -> Array:
        """False positive rate (k,), eq. 10.2."""
        return self.fp / self.negatives

    @property
    def area(self) -> float:
        """Area under the curve: the probability that a sign is more like one than something else."""
        return float(area_under(self.fpr, self.tpr))

    @property
    def knee(self) -> int:
        """Row of the largest TPR - FPR."""
        return int(np.argmax(self.tpr - self.fpr))

    def at(self, threshold: float) -> int:
        """Row of the loosest threshold of the curve that is no looser than this one."""
        looser = self.threshold > threshold if self.accept_below else self.threshold < threshold
        return int(np.argmax(looser)) - 1 if looser.any() else len(looser) - 1

    @property
    def used_row(self) -> int | None:
        """Row of the threshold of the run."""
        return None if np.isnan(self.used) else self.at(self.used)

    @cached_property
    def bands(self) -> Bands:
        """By resampled groups; unknown where signs or others are in one group only."""
        every = self.accepted[:, :, -1]
        if min((every > 0).sum(axis=1)) < 2:
            return Bands()
        weight = resamplings(every.shape[1])
        totals = every @ weight.T
        usable = (totals > 0).all(axis=0)  # a resampling may have no sign, or nothing else
        rates = weight[usable] @ self.accepted[:, :, :-1] / totals[:, usable, None]
        fpr, tpr = np.quantile(rates, TAILS, axis=1).transpose(1, 2, 0)
        area = Interval(*np.quantile(area_under(*rates), TAILS).tolist())
        knees = self.threshold[np.argmax(rates[1] - rates[0], axis=1)]
        knees = knees[np.isfinite(knees)]
        ends = np.quantile(knees, TAILS, method="nearest").tolist() if len(knees) else None
        return Bands(tpr, fpr, area, None if ends is None else Interval(*ends))


def area_under(fpr: Array, tpr: Array) -> Array:
    """Area (...) under curves of rates (..., k) by trapezoids, the last point joined with (1, 1): ties count half."""
    area = np.asarray(np.trapezoid(tpr, fpr, axis=-1))
    return area + (1 - fpr[..., -1]) * (1 + tpr[..., -1]) / 2


def resampled_groups(drive: NDArray[np.str_], frame: NDArray[np.int32]) -> tuple[Numbers, str]:
    """Number of the group (n,) that each sample is resampled with, and what a group is: `drive`, or `stretch`."""
    names, group = np.unique(drive, return_inverse=True)
    if len(names) > 1:
        return group.astype(np.int64), "drive"
    return frame.astype(np.int64) // STRETCH_FRAMES, "stretch"


def roc_curves(
    samples: Mapping[str, ClassifierSamples], settings: Settings, models: Models
) -> Iterator[RocCurve]:
    """Every test of the classifiers that were asked, in the order of the chain.

    A class of colour or shape is tested with its own signs against what is no sign; signs of other classes count in the
    confusion. A landmark is tested by the sum of its evidence (`all`) and by each term alone. A place has no class: a
    sign belongs to the component of the model that is likeliest. `all` is a classifier of several classes as a whole:
    it accepts what the likelihood ratio of any class accepts.
    """
    for classifier, every in samples.items():
        yield from _curves_of(classifier, every.known(), settings, models)


def _curves_of(
    classifier: str, own: ClassifierSamples, settings: Settings, models: Models
) -> Iterator[RocCurve]:
    group, resampled = resampled_groups(own.drive, own.frame)
    on, everything = own.label == ON, np.ones(len(own), np.bool_)
    value, gate = own.values[:, 0], settings.gate

    def curve(
        name: str,
        value: Array,
        threshold: float,
        unit: str,
        rows: Flags = everything,
        *,
        below: bool = False,
    ) -> RocCurve:
        columns = (value[rows], on[rows], own.count[rows], group[rows])
        return RocCurve(*columns, below, classifier, name, threshold, unit, resampled)

    model = {
        "color": models.color_classes,
        "shape": models.shape_classes,
        "location": models.location_classes,
    }.get(classifier)
    if classifier == "size":
        yield curve("smallest", value, gate.smallest_px, "px")
        yield curve("largest", value, gate.largest_px, "px", below=True)
    elif model is not None:
        ratio, unit = log_ratios(own.values, model), "log-likelihood ratio"
        yield curve(ALL, ratio.max(axis=1), model.threshold, unit)
        likeliest = np.nan_to_num(ratio, nan=-np.inf).argmax(axis=1)
        has_classes = bool((own.kind != NO_CLASS).any())
        for j, one in enumerate(model.classes):
            rows = ~on | (own.kind == one.name) if has_classes else likeliest == j
            yield curve(one.name, ratio[:, j], model.threshold, unit, rows)
    elif classifier == "confidence":
        yield curve(ALL, value, models.sign_confidence(settings.locate.confidence), "probability")
    else:
        learned, unit = {
            "detector": (models.front_scores, "log odds"),
            "landmark": (models.landmark_classifier, "log odds"),
            "trajectory": (models.trajectory_density, "mean log density"),
        }[classifier]
        yield curve(ALL, value, np.nan if learned is None else learned.threshold, unit)
        # no term decides by itself
        terms = dict.fromkeys(learned.terms) if isinstance(learned, EvidenceModel) else ()
        for column, term in enumerate(terms, 1):
            yield curve(term, own.values[:, column], np.nan, "log-likelihood ratio")
