"""Learned models: Gaussian classes, mixtures, thresholds, evidence."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class OnnxFile:
    """A network in an ONNX file."""

    path: str
    """Of the file."""
    sha256: str
    """Of its content when it was named."""


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """What a gate does at given thresholds."""

    false_alarm: float
    """Share of others that it accepts where the model was learned (eq. 10.2)."""
    power: float
    """Share of signs that it accepts there (eq. 10.1)."""
    threshold: float
    """Least accepted value."""
    interval: tuple[float, float] | None = None
    """95 % interval of the threshold. None: unknown."""


@dataclass(frozen=True, slots=True)
class GaussianClass:
    """One class of a Gaussian model, or one component of its background, in d dimensions."""

    name: str
    """Of the class."""
    mean: NDArray[np.float64]
    """(d,)."""
    covariance: NDArray[np.float64]
    """(d, d)."""
    count: int
    """Samples it was learned from, and its weight."""


@dataclass(frozen=True, slots=True)
class ModelText:
    """What all kinds of models share."""

    text_digest: str = field(default="", init=False, repr=False, compare=False)
    """SHA-256 of the text it was read from. Empty: made or changed, since `replace` leaves it out."""


@dataclass(frozen=True, slots=True)
class GaussianModel(ModelText):
    """Classes by Mahalanobis distance (report eq. 3.1), and a gate by likelihood ratio (report chapter 9)."""

    kind: ClassVar[str] = "gaussian"
    space: str
    """Name of the space of its values."""
    classes: tuple[GaussianClass, ...]
    """The classes."""
    provenance: str
    """What it was learned from."""
    background: tuple[GaussianClass, ...] = ()
    """Components of the density of what is no sign. Empty: as likely everywhere."""
    threshold: float = -np.inf
    """Least accepted logarithm of the likelihood ratio of a class to the background. -inf: it is no gate."""
    threshold_rule: str = ""
    """How the threshold was chosen. Empty: it is no gate."""
    threshold_interval: tuple[float, float] | None = None
    """95 % interval, by resampling the drives it was learned from. None: unknown."""
    curve: tuple[OperatingPoint, ...] = ()
    """Operating points, by rising false-alarm rate. Empty: unknown."""


@dataclass(frozen=True, slots=True)
class MixtureModel(ModelText):
    """Likelihood ratio of signs and other things: the densities are sums of k Gaussian components in d dimensions."""

    kind: ClassVar[str] = "mixture"
    space: str
    """Name of the space of its values."""
    signs: int
    """The first so many components are of signs, the rest of other things."""
    weight: NDArray[np.float64]
    """(k,), of sum 1 for signs and for other things."""
    mean: NDArray[np.float64]
    """(k, d)."""
    covariance: NDArray[np.float64]
    """(k, d, d)."""
    threshold: float
    """Least accepted mean of the log ratio over the values of one item."""
    threshold_rule: str
    """How the threshold was chosen, and its rates."""
    provenance: str
    """What it was learned from."""
    threshold_interval: tuple[float, float] | None = None
    """95 % interval of the threshold. None: unknown."""
    curve: tuple[OperatingPoint, ...] = ()
    """Operating points, by rising false-alarm rate. Empty: unknown."""


@dataclass(frozen=True, slots=True)
class NetworkSum:
    """Weights of the two networks in the score of a box: own * score + network * other score + shift."""

    own: float
    """Weight of the log odds by the box network."""
    network: float
    """Weight of the log odds by the detection network at the middle of the box."""
    shift: float
    """Such that boxes with and without the sum have one threshold."""


@dataclass(frozen=True, slots=True)
class ScoreModel(ModelText):
    """Threshold of the box network for panels seen from one side."""

    kind: ClassVar[str] = "score"
    threshold: float
    """Least accepted log odds."""
    provenance: str
    """What it was learned from."""
    with_network: NetworkSum | None = None
    """How the score is joined with that of a detection network. None: it is not."""
    threshold_rule: str = ""
    """How the threshold was chosen. Empty: unknown."""
    threshold_interval: tuple[float, float] | None = None
    """95 % interval of the threshold. None: unknown."""


@dataclass(frozen=True, slots=True)
class LinearModel(ModelText):
    """The value of a candidate is the weighted sum of its features."""

    kind: ClassVar[str] = "linear"
    features: tuple[str, ...]
    """Names of the features."""
    weights: NDArray[np.float64]
    """(features,)."""
    provenance: str
    """What it was learned from."""


@dataclass(frozen=True, slots=True)
class EvidenceModel(ModelText):
    """Log-likelihood ratios of terms of evidence, each the sum of one monotone curve per feature.

    A curve is linear between its knots and level beyond them. A feature that is nan says nothing.
    """

    kind: ClassVar[str] = "evidence"
    features: tuple[str, ...]
    """Names of the f features."""
    terms: tuple[str, ...]
    """Name of the term that each feature is of, (f,)."""
    knots: tuple[NDArray[np.float64], ...]
    """Values of each feature, ascending: f arrays (k,)."""
    curves: tuple[NDArray[np.float64], ...]
    """Log-likelihood ratios at the knots: f arrays (k,)."""
    shift: float
    """Log odds where all terms are 0."""
    threshold: float
    """Log odds from which a landmark is accepted."""
    provenance: str
    """What it was learned from."""
    decision: float = 0.0
    """Log odds from which an accepted landmark is no longer uncertain."""
    threshold_rule: str = ""
    """How the decision was chosen. Empty: unknown."""
    threshold_interval: tuple[float, float] | None = None
    """95 % interval of the decision. None: unknown."""
    curve: tuple[OperatingPoint, ...] = ()
    """Operating points of the decision. Empty: unknown."""


Model = GaussianModel | MixtureModel | ScoreModel | LinearModel | EvidenceModel
