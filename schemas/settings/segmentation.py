"""Settings of the two-pass segmentation and its size gate (report chapters 2 and 3.1)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class SegmentSettings:
    """Two-pass K-means (report chapter 2)."""

    clusters: int = setting(16, "colours", "k of pass one", low=2, high=256)
    difference_clusters: int = setting(
        5, "classes", "k of pass two, on the difference image", low=3, high=256
    )
    whole_picture: bool = setting(
        False, "", "segment the whole image instead of the band where signs can be"
    )


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Size gate (report section 3.1)."""

    smallest_px: int = setting(50, "px", "regions of fewer pixels are dropped", low=1)
    largest_px: int = setting(200_000, "px", "regions of more pixels are dropped", low=1)
