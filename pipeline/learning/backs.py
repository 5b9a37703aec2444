"""The box classifier of panels seen from behind, learned as that of faces is, from the same candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from wayside.pipeline.learning.cross_validation import out_of_fold_models
from wayside.pipeline.learning.detector import FeaturedDrive, detection_rates, fit_box_classifier
from wayside.pipeline.learning.samples import ON, labelled
from wayside.schemas.errors import InputError
from wayside.schemas.models import TreeModel
from wayside.stages.classifiers import log_odds

FALSE_PER_IMAGE = 1.0
"""Boxes off any back, after suppression, that pass in a held-out image."""

FEWEST = 5
"""Candidates on backs in half of the drives without which nothing is learned."""


def learn_back_classifier(
    passed: Sequence[FeaturedDrive], seed: int, provenance: str, max_iou: float
) -> TreeModel:
    """Learn from the candidates of rendered drives: backs of real images have no boxes.

    `max_iou` is the overlap above which the lower of two boxes is suppressed.

    Raises
    ------
    InputError
        Where too few candidates are on backs.
    UsageError
        Without scikit-learn, which only the learning needs.
    """
    seen = [of_backs(one) for one in passed if not one.real]
    on = [int((one.candidates.label == ON).sum()) for one in seen]
    fewest = min(sum(group) for group in (on[0::2], on[1::2]) if group)
    if fewest < FEWEST:
        raise InputError(
            f"classifier of backs: wanted {FEWEST} candidates on backs of panels in either half of the drives, "
            f"found {fewest}; add drives"
        )
    names = [one.drive.name for one in seen]
    classifier, others = out_of_fold_models(
        names, seen, lambda some: fit_box_classifier(some, seed)
    )
    rates = detection_rates(
        seen,
        [log_odds(others[n], one.values) for n, one in zip(names, seen, strict=True)],
        FALSE_PER_IMAGE,
        max_iou,
    )
    return replace(
        classifier,
        threshold=rates.threshold,
        threshold_rule=rates.rule,
        threshold_interval=rates.interval,
        provenance=f"{provenance}; backs of panels, {rates.words()}",
    )


def of_backs(one: FeaturedDrive) -> FeaturedDrive:
    """The same candidates, labelled by the backs that the images show instead of the faces."""
    backs, candidates = one.drive.backs, one.candidates
    drive = replace(one.drive, true_faces=backs, wanted=backs.is_example)
    return replace(
        one,
        drive=drive,
        candidates=labelled(candidates.regions, candidates.frame, backs),
    )
