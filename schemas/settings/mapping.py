"""Settings of tracks, landmarks and their classification by location (report chapters 5, 7, 8 and 11)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """Following candidates from frame to frame and measuring them."""

    longest: int = setting(14, "frames", "frames over which a sign is followed", low=2)
    fewest_views: int = setting(2, "views", "places with fewer views are not reported", low=2)
    gap_px: float = setting(
        3.0, "px", "largest epipolar or reprojection gap of a match, before the size's share", low=0
    )
    matching: str = setting(
        "places",
        "",
        "places: by predicted position; sift: by descriptors (the report)",
        choices=("places", "sift"),
    )


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """Classification by location, and what is reported."""

    confidence: float = setting(
        0.5, "", "places below this confidence get status uncertain", low=0, high=1
    )
    beyond: float = setting(
        0.8,
        "log odds",
        "a place farther than a model's threshold from all places of signs must be a sign by so much for each "
        "unit of distance beyond; a large number: none may lie there",
        low=0,
    )
    smallest_side_m: float = setting(
        0.12, "m", "panels with a smaller side are refused", low=0, high=10
    )
    largest_side_m: float = setting(
        7.0, "m", "panels with a larger side are refused", low=0, high=100
    )
