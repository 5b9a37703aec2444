"""The judge of one view for panels seen from behind: bare backs, learned as faces are, from the same candidates.

All that judges a drive here has not seen it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from wayside.pipeline.learning.judging import Passed, fit_judge, found_at
from wayside.pipeline.learning.samples import ON, labelled
from wayside.pipeline.learning.strangers import for_strangers
from wayside.schemas.errors import InputError
from wayside.schemas.models import TreeModel
from wayside.stages.classifiers import log_odds

FALSE_PER_PICTURE = 1.0
"""Boxes off any back, after suppression, that pass in a held-out picture."""

FEWEST = 5
"""Candidates on backs in half of the drives without which nothing is learned."""


@dataclass(frozen=True, slots=True)
class BackJudges:
    """The judge taught with all drives, and for each drive, by name, one that never saw it."""

    judge: TreeModel
    strangers: dict[str, TreeModel]


def learn_backs(passed: Sequence[Passed], seed: int, provenance: str) -> BackJudges:
    """Learn the judge from what the gate let pass of rendered drives: nobody has boxed the backs of real pictures.

    Raises
    ------
    InputError
        Where too few candidates are on backs.
    UsageError
        Without scikit-learn, which only the learning needs.
    """
    seen = [of_backs(one) for one in passed if not one.real]
    on = [int((one.views.label == ON).sum()) for one in seen]
    fewest = min(sum(group) for group in (on[0::2], on[1::2]) if group)
    if fewest < FEWEST:
        raise InputError(
            f"judge of backs: wanted {FEWEST} candidates on backs of panels in either half of the drives, "
            f"found {fewest}; add drives"
        )
    names = [one.drive.name for one in seen]
    judge, others = for_strangers(names, seen, lambda some: fit_judge(some, seed))
    held = found_at(
        seen,
        [log_odds(others[n], one.values) for n, one in zip(names, seen, strict=True)],
        FALSE_PER_PICTURE,
    )
    words = f"{provenance}; backs of panels, {held.words()}; accept at {FALSE_PER_PICTURE:g} false boxes a picture"
    return BackJudges(
        replace(judge, accept=held.accept, provenance=words),
        {name: replace(other, accept=held.accept) for name, other in others.items()},
    )


def of_backs(one: Passed) -> Passed:
    """The same candidates, labelled by the backs that the pictures show instead of the faces."""
    backs, views = one.drive.backs, one.views
    drive = replace(one.drive, shown=backs, wanted=backs.teaches)
    return replace(
        one, drive=drive, views=labelled(views.regions, views.glance, views.frame, backs)
    )
