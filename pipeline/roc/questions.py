"""Each classifier and class as one test: the values of its samples, and the threshold that the run compares with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.samples import ON
from wayside.pipeline.model_files import Models
from wayside.pipeline.roc.classifier_samples import NO_CLASS, ClassifierSamples
from wayside.pipeline.roc.curves import RocCurve, Scores, resampled_groups
from wayside.schemas.models import EvidenceModel, GaussianModel
from wayside.schemas.settings import Settings

ALL = "all"
"""Class of a classifier as a whole."""


@dataclass(frozen=True, slots=True)
class Question:
    """A classifier's test for one class.

    threshold: that of the run, nan where it has none; unit: of its values; resampled: what the groups of the scores
    are.
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
    gate, model = settings.gate, gaussian_model(classifier, models)

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

    if classifier == "size":
        yield question("smallest", own.values[:, 0], gate.smallest_px, "px")
        yield question("largest", own.values[:, 0], gate.largest_px, "px", below=True)
    elif model is not None:
        distance = model.distances(own.values)
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
        yield question(ALL, own.values[:, 0], least, "probability")
    else:
        learned, unit = {
            "detector": (models.front_scores, "log odds"),
            "landmark": (models.landmark_classifier, "log odds"),
            "trajectory": (models.trajectory_density, "mean log density"),
        }[classifier]
        yield question(
            ALL, own.values[:, 0], np.nan if learned is None else learned.threshold, unit
        )
        # no term decides by itself
        terms = learned.term_names if isinstance(learned, EvidenceModel) else ()
        for column, term in enumerate(terms, 1):
            yield question(term, own.values[:, column], np.nan, "log-likelihood ratio")


def gaussian_model(classifier: str, models: Models) -> GaussianModel | None:
    """The model of a classifier by Mahalanobis distance; None where it is another kind."""
    return {
        "color": models.color_classes,
        "shape": models.shape_classes,
        "location": models.location_classes,
    }.get(classifier)


def confusion(samples: ClassifierSamples) -> dict[tuple[str, str], int]:
    """How many samples of each labelled class got which class, as the run decided."""
    own = samples.known()
    counts: Counter[tuple[str, str]] = Counter()
    for label, kind, accepted, named, count in zip(
        own.label.tolist(),
        own.kind.tolist(),
        own.accepted.tolist(),
        own.named.tolist(),
        own.count.tolist(),
        strict=True,
    ):
        labelled = (kind or "sign") if label == ON else "none"
        counts[labelled, (named or "accepted") if accepted else "refused"] += count
    return dict(sorted(counts.items()))
