"""Settings of the candidates for sign faces and of the detector that classifies them."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class CandidateSettings:
    """Where candidates for sign faces come from and how they are classified in one image."""

    keep: int = setting(
        60,
        "candidates",
        "so many of the best in one image may begin landmarks; others may join them",
        low=1,
    )
    external_score: float = setting(
        0.25,
        "",
        "boxes of another detector, or of a file, with a smaller score are left out",
        origin="the default of Ultralytics' predictions",
        low=0,
        high=1,
    )
