"""Settings of what one image shows: white balance, regions (report chapters 2 and 3.1), candidates for sign faces."""

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class BalanceSettings:
    """White balance by the road, whose asphalt is grey."""

    on: bool = setting(True, "", "remove the colour cast that the road shows from the whole image")


@dataclass(frozen=True, slots=True)
class SegmentSettings:
    """Two-pass K-means (report chapter 2)."""

    clusters: int = setting(16, "colours", "k of pass one", low=2, high=256)
    difference_clusters: int = setting(
        5, "classes", "k of pass two, on the difference image", low=3, high=256
    )


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Size gate (report section 3.1)."""

    smallest_px: int = setting(50, "px", "regions of fewer pixels are dropped", low=1)
    largest_px: int = setting(200_000, "px", "regions of more pixels are dropped", low=1)


@dataclass(frozen=True, slots=True)
class CandidateSettings:
    """Where candidates for sign faces come from and how they are classified in one image."""

    keep: int = setting(
        60,
        "candidates",
        "best candidates of an image that may begin landmarks; others may join them",
        low=1,
    )
    external_score: float = setting(
        0.25,
        "",
        "boxes of another detector or from a file with a smaller score are left out",
        origin="the default of Ultralytics' predictions",
        low=0,
        high=1,
    )
