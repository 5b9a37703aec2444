"""Settings of the candidates for sign faces and the classifiers that decide on them."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class CandidateSettings:
    """Where candidates for sign faces come from and how they are judged in one picture."""

    judge: str = setting(
        "trees",
        "",
        "trees: learned judge on every candidate; report: colour and shape distances",
        choices=("trees", "report"),
    )
    most: int = setting(950, "candidates", "at most this many are looked at in one picture", low=1)
    keep: int = setting(
        60, "candidates", "at most this many of the best are followed in one picture", low=1
    )
