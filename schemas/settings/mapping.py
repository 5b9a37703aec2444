"""Settings of tracking and of location (report chapters 5 and 11)."""

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """Following candidates from frame to frame and measuring them."""

    longest: int = setting(
        14, "frames", "number of frames over which a sign is followed, its last ones", low=2
    )
    fewest_views: int = setting(2, "views", "landmarks with fewer views are not reported", low=2)
    gap_px: float = setting(
        3.0, "px", "largest epipolar or reprojection error of a match, plus a share of size", low=0
    )


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """Classification by location, and what is reported."""

    gate: bool = setting(
        True, "", "reject landmarks unlike signs in place or size; false: keep all"
    )
    confidence: float = setting(
        0.5,
        "",
        "signs below this confidence get status uncertain; with a false-alarm rate (models.alpha), 0.5 means "
        "the confidence that this rate needs",
        low=0,
        high=1,
    )
    smallest_side_m: float = setting(
        0.12, "m", "panels with a smaller side are rejected", low=0, high=10
    )
    largest_side_m: float = setting(
        12.0, "m", "panels with a larger side are rejected", low=0, high=100
    )
