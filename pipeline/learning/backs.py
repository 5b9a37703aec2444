"""The judge of one view for panels seen from behind: bare backs, learned as faces are, from the same candidates.

All that judges a drive here has not seen it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from wayside.pipeline.learning.cross_validation import out_of_fold_models
from wayside.pipeline.learning.detector import PrefilteredDrive, detection_rates, fit_box_classifier
from wayside.pipeline.learning.samples import ON, labelled
from wayside.schemas.errors import InputError
from wayside.schemas.models import TreeModel
from wayside.stages.classifiers import log_odds

FALSE_PER_PICTURE = 1.0
"""Boxes off any back, after suppression, that pass in a held-out picture."""

FEWEST = 5
"""Candidates on backs in half of the drives without which nothing is learned."""


@dataclass(frozen=True, slots=True)
class TrainedBackClassifier:
    """The judge taught with all drives, and for each drive, by name, one that never saw it."""

    judge: TreeModel
    out_of_fold: dict[str, TreeModel]


def learn_back_classifier(
    passed: Sequence[PrefilteredDrive], seed: int, provenance: str
) -> TrainedBackClassifier:
    """Learn the judge from what the gate let pass of rendered drives: nobody has boxed the backs of real pictures.

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
            f"judge of backs: wanted {FEWEST} candidates on backs of panels in either half of the drives, "
            f"found {fewest}; add drives"
        )
    names = [one.drive.name for one in seen]
    judge, others = out_of_fold_models(names, seen, lambda some: fit_box_classifier(some, seed))
    rates = detection_rates(
        seen,
        [log_odds(others[n], one.values) for n, one in zip(names, seen, strict=True)],
        FALSE_PER_PICTURE,
    )
    words = f"{provenance}; backs of panels, {rates.words()}; accept at {FALSE_PER_PICTURE:g} false boxes a picture"
    return TrainedBackClassifier(
        replace(judge, threshold=rates.threshold, provenance=words),
        {name: replace(other, threshold=rates.threshold) for name, other in others.items()},
    )


def of_backs(one: PrefilteredDrive) -> PrefilteredDrive:
    """The same candidates, labelled by the backs that the pictures show instead of the faces."""
    backs, candidates = one.drive.backs, one.candidates
    drive = replace(one.drive, true_faces=backs, wanted=backs.is_example)
    return replace(
        one,
        drive=drive,
        candidates=labelled(
            candidates.regions, candidates.prefilter_values, candidates.frame, backs
        ),
    )
