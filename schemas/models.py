"""Learned models: Gaussian classes, mixtures, thresholds, evidence. Their files are written by `model_json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isnan
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class OnnxFile:
    """A network in an ONNX file: `path`, and the SHA-256 of what it held when it was named."""

    path: str
    sha256: str


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """What a gate does at given thresholds: the shares of others and of signs that it accepts (eq. 10.2 and 10.1).

    false_alarm, power: where the model was learned; thresholds: of each class, in the order of the model's; intervals:
    95 % interval of each threshold, empty: unknown.
    """

    false_alarm: float
    power: float
    thresholds: tuple[float, ...]
    intervals: tuple[tuple[float, float], ...] = ()


def most_powerful(curve: Sequence[OperatingPoint], alpha: float) -> OperatingPoint:
    """The operating point of the most power among those of at most this false-alarm rate (report chapter 9).

    Raises
    ------
    ValueError
        There is none.
    """
    allowed = [one for one in curve if one.false_alarm <= alpha]
    if not allowed:
        rates = ", ".join(f"{one.false_alarm:g}" for one in curve) or "none"
        raise ValueError(
            f"no operating point has a false-alarm rate of at most {alpha:g}; the rates are {rates}"
        )
    return max(allowed, key=lambda one: one.power)


def alpha_rule(alpha: float) -> str:
    """The rule of such a threshold, as model files name it."""
    return f"alpha {alpha:g}: most true positives of at most this false positive rate (report chapter 9)"


@dataclass(frozen=True, slots=True)
class GaussianClass:
    """One class: mean (d,), covariance (d, d), largest accepted distance, the rule that set it, samples.

    threshold_interval: 95 % interval of the threshold, by resampling the drives it was learned from; None: unknown.
    """

    name: str
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    threshold: float
    threshold_rule: str
    count: int
    threshold_interval: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class ModelText:
    """What the kinds of models share.

    text_digest: SHA-256 of the text that a model was read from; "" where it was made or changed. It is no argument, so
    that `dataclasses.replace` leaves it out: a changed model has no text yet.
    """

    text_digest: str = field(default="", init=False, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class GaussianModel(ModelText):
    """Classes by Mahalanobis distance (report eq. 3.1), in the named space.

    curve: operating points of all classes together, by rising false-alarm rate; empty: unknown.
    """

    kind: ClassVar[str] = "gaussian"
    space: str
    classes: tuple[GaussianClass, ...]
    provenance: str
    curve: tuple[OperatingPoint, ...] = ()

    def distances(self, values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Mahalanobis distance of each value (n, d) to each class: (n, classes), eq. 3.1."""
        result = np.empty((len(values), len(self.classes)))
        for j, one in enumerate(self.classes):
            difference = np.asarray(values, np.float64) - one.mean
            result[:, j] = np.sqrt(
                np.einsum("ni,ij,nj->n", difference, np.linalg.inv(one.covariance), difference)
            )
        return result

    def at_alpha(self, alpha: float) -> GaussianModel:
        """The model with the thresholds of the most power among its operating points of at most this false-alarm rate.

        Raises
        ------
        ValueError
            The model has no such operating point.
        """
        point = most_powerful(self.curve, alpha)
        intervals = point.intervals or (None,) * len(self.classes)
        chosen = zip(self.classes, point.thresholds, intervals, strict=True)
        classes = tuple(
            replace(
                one,
                threshold=threshold,
                threshold_rule=alpha_rule(alpha),
                threshold_interval=interval,
            )
            for one, threshold, interval in chosen
        )
        return replace(self, classes=classes)


@dataclass(frozen=True, slots=True)
class MixtureModel(ModelText):
    """Density of what is typical, in the named space: a sum of k Gaussian components.

    weight (k,), of sum 1; mean (k, d); covariance (k, d, d); threshold: smallest accepted mean of the log density over
    the values of one item; threshold_rule: how it was chosen, and its rates; count: items that were learned from.
    threshold_interval, curve: as in `GaussianModel`, of the one threshold.
    """

    kind: ClassVar[str] = "mixture"
    space: str
    weight: NDArray[np.float64]
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    threshold: float
    threshold_rule: str
    count: int
    provenance: str
    threshold_interval: tuple[float, float] | None = None
    curve: tuple[OperatingPoint, ...] = ()

    def at_alpha(self, alpha: float) -> MixtureModel:
        """The model with another threshold: as in `GaussianModel`."""
        point = most_powerful(self.curve, alpha)
        return replace(
            self,
            threshold=point.thresholds[0],
            threshold_rule=alpha_rule(alpha),
            threshold_interval=point.intervals[0] if point.intervals else None,
        )

    def log_density(self, values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Natural logarithm of the density at each value (n, d): (n,)."""
        return np.asarray(np.logaddexp.reduce(self.log_parts(values), axis=1))

    def log_parts(self, values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Logarithm of each component's part in the density at each value: (n, k)."""
        d = self.mean.shape[1]
        gap = np.asarray(values, np.float64)[:, None] - self.mean
        square = np.einsum("nki,kij,nkj->nk", gap, np.linalg.inv(self.covariance), gap)
        _, log_volume = np.linalg.slogdet(self.covariance)
        parts = np.log(self.weight) - (log_volume + d * np.log(2 * np.pi) + square) / 2
        return np.asarray(parts)


@dataclass(frozen=True, slots=True)
class NetworkSum:
    """What a box scores by the box network and by the detection network together.

    own * (log odds by the box network) + network * (log odds by the other at the middle of the box) + shift. The shift
    is such that both are accepted at one threshold.
    """

    own: float
    network: float
    shift: float

    def of(self, own: NDArray[np.float32], network: NDArray[np.float32]) -> NDArray[np.float32]:
        """The sum (n,) of scores by the box network (n,) and by the detection network (n,)."""
        joined = np.float32(self.own) * own + np.float32(self.network) * network
        return np.asarray(joined + np.float32(self.shift), np.float32)


@dataclass(frozen=True, slots=True)
class ScoreModel(ModelText):
    """From which log odds of the box network a box is accepted as a panel seen from one side.

    with_network: how they are joined with the score of a detection network, where a run has one. threshold_rule,
    threshold_interval: how the threshold was chosen, and its 95 % interval, "" and None: unknown.
    """

    kind: ClassVar[str] = "score"
    threshold: float
    provenance: str
    with_network: NetworkSum | None = None
    threshold_rule: str = ""
    threshold_interval: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class LinearModel(ModelText):
    """Weights (f,) float64 of named features: the value of a candidate is their weighted sum."""

    kind: ClassVar[str] = "linear"
    features: tuple[str, ...]
    weights: NDArray[np.float64]
    provenance: str

    def values(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (n,) of candidates with features (n, f)."""
        return np.asarray(features @ self.weights, np.float64)


@dataclass(frozen=True, slots=True)
class EvidenceModel(ModelText):
    """Log-likelihood ratios of terms of evidence, each the sum of one monotone curve per feature.

    A curve is linear between its knots, which span what was learned from, and level beyond them; a feature that is nan
    says nothing. features, terms (f,): names; knots, curves (f,) arrays (k,): feature values, ascending, and the
    log-likelihood ratio there; shift: log odds where all terms are 0; threshold: log odds from which a landmark is
    accepted; decision: log odds from which what is accepted is no longer uncertain, where nothing else is asked for.
    threshold_rule, threshold_interval: how the decision was chosen, and its 95 % interval, "" and None: unknown.
    curve: operating points of the decision.
    """

    kind: ClassVar[str] = "evidence"
    features: tuple[str, ...]
    terms: tuple[str, ...]
    knots: tuple[NDArray[np.float64], ...]
    curves: tuple[NDArray[np.float64], ...]
    shift: float
    threshold: float
    provenance: str
    decision: float = 0.0
    threshold_rule: str = ""
    threshold_interval: tuple[float, float] | None = None
    curve: tuple[OperatingPoint, ...] = ()

    def at_alpha(self, alpha: float) -> EvidenceModel:
        """The model that decides at another operating point; the log odds stay what they are.

        What is uncertain stays as wide, in log odds. Raises as `GaussianModel.at_alpha` does.
        """
        point = most_powerful(self.curve, alpha)
        decision = point.thresholds[0]
        return replace(
            self,
            threshold=self.threshold + decision - self.decision,
            decision=decision,
            threshold_rule=alpha_rule(alpha),
            threshold_interval=point.intervals[0] if point.intervals else None,
        )

    @property
    def term_names(self) -> tuple[str, ...]:
        """The terms, each once, in the order of `ratios`."""
        return tuple(dict.fromkeys(self.terms))

    def ratios(self, values: Mapping[str, float]) -> dict[str, float]:
        """Log-likelihood ratio of each term by values of the features."""
        result = dict.fromkeys(self.term_names, 0.0)
        columns = zip(self.features, self.terms, self.knots, self.curves, strict=True)
        for name, term, knots, curve in columns:
            if not isnan(values[name]):
                result[term] += float(np.interp(values[name], knots, curve))
        return result


Model = GaussianModel | MixtureModel | ScoreModel | LinearModel | EvidenceModel
