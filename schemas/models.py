"""Learned models: Gaussian classes, mixtures, thresholds, evidence. `pipeline/model_json.py` reads and writes them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

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


@dataclass(frozen=True, slots=True)
class NetworkSum:
    """What a box scores by the box network and by the detection network together.

    own * (log odds by the box network) + network * (log odds by the other at the middle of the box) + shift. The shift
    is such that both are accepted at one threshold.
    """

    own: float
    network: float
    shift: float


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


Model = GaussianModel | MixtureModel | ScoreModel | LinearModel | EvidenceModel
