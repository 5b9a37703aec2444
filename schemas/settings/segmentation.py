"""Settings of the two-pass segmentation and its size gate (report chapters 2 and 3.1)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting

_CHOSEN = "chosen by hand"
_HANG = "where faces hang beside and over roads"


@dataclass(frozen=True, slots=True)
class SegmentSettings:
    """Two-pass K-means (report chapter 2)."""

    clusters: int = setting(16, "colours", "k of pass one", low=2, high=256)
    difference_clusters: int = setting(
        16, "classes", "k of pass two, on the difference image", low=2, high=256
    )
    whole_picture: bool = setting(
        False, "", "segment the whole image instead of the band where signs can be"
    )
    sample_px: int = setting(
        80_000,
        "px",
        "the palette is made from at least so many pixels of an image",
        origin=_CHOSEN,
        expert=True,
        low=1,
    )
    seed: int = setting(
        1, "", "seed of the first start of k-means++; further starts count on", expert=True, low=0
    )
    starts: int = setting(
        2,
        "starts",
        "starts of K-means; the one of the smallest sum of squared distances is taken",
        origin=_CHOSEN,
        expert=True,
        low=1,
    )
    trials: int = setting(
        4,
        "draws",
        "draws for each centre of a start; the one that explains most is taken",
        origin="greedy k-means++, Arthur and Vassilvitskii 2007",
        expert=True,
        low=1,
    )
    lloyd_steps: int = setting(
        20, "steps", "Lloyd steps of a start, at most", origin=_CHOSEN, expert=True, low=1
    )
    settled: float = setting(
        0.5,
        "colour levels",
        "Lloyd steps end when no centre moves further",
        origin="centres are rounded to whole levels",
        expert=True,
        low=0,
    )
    roadside_top_m: float = setting(
        2.2, "m", "top of roadside faces above the camera", origin=_HANG, expert=True
    )
    roadside_range_m: float = setting(
        12.0, "m", "roadside faces are segmented down to this range", origin=_HANG, expert=True
    )
    overhead_top_m: float = setting(
        6.5, "m", "top of overhead faces above the camera", origin=_HANG, expert=True
    )
    overhead_range_m: float = setting(
        35.0, "m", "overhead faces are segmented down to this range", origin=_HANG, expert=True
    )
    lowest_edge_m: float = setting(
        1.1, "m", "lower edge of faces below the camera", origin=_HANG, expert=True
    )
    pitch_margin_deg: float = setting(
        2.0,
        "degrees",
        "the camera's own pitch, brakes and hills turn the horizon by about this much",
        origin=_CHOSEN,
        expert=True,
        low=0,
    )


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Size gate (report section 3.1)."""

    smallest_px: int = setting(50, "px", "regions of fewer pixels are dropped", low=1)
    largest_px: int = setting(200_000, "px", "regions of more pixels are dropped", low=1)
