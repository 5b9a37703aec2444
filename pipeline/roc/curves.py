"""True and false positive rates of a classifier over its thresholds: area, knee and confidence bands (chapter 10).

A rate is of counted samples: TPR = TP / (TP + FN) (eq. 10.1), FPR = FP / (FP + TN) (eq. 10.2). Samples of one drive are
alike, so bands resample whole drives (Efron and Tibshirani 1993, chapter 8), or stretches of one drive where there is
no other; never single frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.statistics import CONFIDENCE, Interval

KNEE_RULE = "knee of the ROC: largest true minus false positive rate (report chapter 10)"
STRETCH_FRAMES = 10
"""Frames of a stretch of a drive that is resampled where there is no second drive."""
DRAWS = 400
"""Resamplings of a band."""
MOST_THRESHOLDS = 400
"""Thresholds of a curve: quantiles of its values where there are more."""


@dataclass(frozen=True, slots=True)
class Scores:
    """Values of n samples of a classifier for one class: `accept_below`, small ones are signs, else large ones.

    value (n,) float64; on (n,) bool: whether it is a sign of the class; count (n,) int64 samples that a row stands for;
    group (n,) int64: number of the drive, or of the stretch of one drive.
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


@dataclass(frozen=True, slots=True)
class RocCurve:
    """Rates (k,) at thresholds from the strictest to the one that accepts everything, with 95 % bands (k, 2).

    threshold (k,): in the unit of the values; the first accepts nothing. tp, fp (k,): counts; positives, negatives: of
    all. knee: row of the largest TPR - FPR. area, area_interval: under the curve, which is the probability that a sign
    is more like one than something else. knee_interval: of the threshold at the knee. groups: how many drives or
    stretches the bands resample; None instead of bands where there is only one.
    """

    threshold: NDArray[np.float64]
    tp: NDArray[np.int64]
    fp: NDArray[np.int64]
    positives: int
    negatives: int
    tpr_band: NDArray[np.float64] | None
    fpr_band: NDArray[np.float64] | None
    area: float
    area_interval: Interval | None
    knee: int
    knee_interval: Interval | None
    groups: int

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


def roc_curve(scores: Scores, seed: int = 1) -> RocCurve | None:
    """The curve of a classifier; None where there is no sign, or nothing else.

    Parameters
    ----------
    scores
        The samples.
    seed
        Of the resampling: same samples, same bands.
    """
    positives = int(scores.count[scores.on].sum())
    negatives = int(scores.count[~scores.on].sum())
    if not positives or not negatives:
        return None
    likeness = scores.likeness
    cuts = _cuts(likeness)
    groups, group = np.unique(scores.group, return_inverse=True)
    row = np.searchsorted(-cuts, -likeness, side="left")  # strictest cut that accepts it
    accepted = np.zeros((2, len(groups), len(cuts) + 1))
    np.add.at(accepted, (scores.on.astype(int), group, row), scores.count)
    every = accepted.sum(axis=2)
    accepted = accepted.cumsum(axis=2)[:, :, : len(cuts)]
    fp, tp = accepted.sum(axis=1).astype(np.int64)
    tpr, fpr = tp / positives, fp / negatives
    knee = int(np.argmax(tpr - fpr))
    tpr_band = fpr_band = area_interval = knee_interval = None
    threshold = -cuts if scores.accept_below else cuts
    if min((every > 0).sum(axis=1)) > 1:
        draw = np.random.default_rng(seed)
        weight = draw.multinomial(len(groups), np.full(len(groups), 1 / len(groups)), DRAWS)
        totals = np.stack([weight @ every[kind] for kind in (0, 1)])
        usable = (totals > 0).all(axis=0)  # a resampling may have no sign, or nothing else
        rates = np.stack(
            [(weight[usable] @ accepted[kind]) / totals[kind, usable, None] for kind in (0, 1)]
        )
        tails = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
        fpr_band, tpr_band = np.quantile(rates, tails, axis=1).transpose(1, 2, 0)
        area_interval = Interval(*np.quantile(area_under(*rates), tails).tolist())
        knees = threshold[np.argmax(rates[1] - rates[0], axis=1)]
        knees = knees[np.isfinite(knees)]
        if len(knees):
            knee_interval = Interval(*np.quantile(knees, tails, method="nearest").tolist())
    return RocCurve(
        threshold,
        tp,
        fp,
        positives,
        negatives,
        tpr_band,
        fpr_band,
        float(area_under(fpr, tpr)),
        area_interval,
        knee,
        knee_interval,
        len(groups),
    )


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


def _cuts(likeness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least accepted likeness (k,), from inf, which accepts nothing, to the smallest."""
    cuts = np.unique(likeness[np.isfinite(likeness)])
    if len(cuts) > MOST_THRESHOLDS:
        at = np.unique(np.linspace(0, len(cuts) - 1, MOST_THRESHOLDS).round().astype(int))
        cuts = cuts[at]
    return np.concatenate([[np.inf], cuts[::-1]])
