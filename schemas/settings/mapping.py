"""Settings of tracking: association of candidates, acceptance of hypotheses, predicted views (report chapter 5)."""

from __future__ import annotations

from dataclasses import dataclass, field

from wayside.schemas.settings.field import SET, setting
from wayside.schemas.settings.landmark import LandmarkSettings, VerdictSettings


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """Following candidates from frame to frame and measuring them."""

    longest: int = setting(
        14,
        "frames",
        "frames over which a sign is followed, the last that show it",
        low=2,
    )
    fewest_views: int = setting(2, "views", "landmarks with fewer views are not reported", low=2)
    gap_px: float = setting(
        3.0, "px", "largest epipolar or reprojection gap of a match, before the size's share", low=0
    )
    window_step: int = setting(
        4,
        "frames",
        "frames between two solutions of the window",
        origin="bounds the time",
        expert=True,
        low=1,
    )


@dataclass(frozen=True, slots=True)
class AssociationSettings:
    """Gates of pairs and of views, and what a view counts."""

    pair_reach: int = setting(
        3,
        "frames",
        "frames between the two candidates of a hypothesis at most",
        origin="one or two views may be missing between",
        expert=True,
        low=1,
    )
    gap_share: float = setting(
        0.06, "heights", "added to track.gap_px", origin=SET, expert=True, low=0
    )
    taller: float = setting(
        1.35, "", "largest ratio of two metric heights", origin=SET, expert=True, low=1
    )
    wider: float = setting(
        1.47, "", "largest ratio of two metric widths", origin=SET, expert=True, low=1
    )
    nearest_m: float = setting(
        4.0, "m", "least depth of a view", origin="nearer panels are cut", expert=True, low=0.1
    )
    farthest_m: float = setting(
        220.0, "m", "largest depth of a view", origin=SET, expert=True, low=1
    )
    aside_m: float = setting(
        45.0,
        "m",
        "largest distance of a panel beside the camera",
        origin="the far side of a freeway",
        expert=True,
        low=0,
    )
    above_m: float = setting(
        12.0, "m", "largest height of a panel above the camera", origin=SET, expert=True, low=0
    )
    below_m: float = setting(
        1.6, "m", "largest depth of a panel below the camera", origin=SET, expert=True, low=0
    )
    horizon_slope: float = setting(
        0.06,
        "m/m",
        "these three grow with depth: far off, road and horizon are not known well",
        origin=SET,
        expert=True,
        low=0,
    )
    narrowest_m: float = setting(
        0.15, "m", "least width of a panel", origin=SET, expert=True, low=0
    )
    lowest_m: float = setting(0.12, "m", "least height of a panel", origin=SET, expert=True, low=0)
    widest_m: float = setting(
        12.0, "m", "largest width of a panel", origin="boards over four lanes", expert=True, low=0
    )
    tallest_m: float = setting(
        8.0, "m", "largest height of a panel", origin=SET, expert=True, low=0
    )
    value_shift: float = setting(
        2.0, "log odds", "added to the score of a view", origin=SET, expert=True
    )
    value_least: float = setting(-1.0, "log odds", "least value of a view", origin=SET, expert=True)
    value_most: float = setting(6.0, "log odds", "largest value of a view", origin=SET, expert=True)
    gap_cost: float = setting(
        1.0,
        "log odds",
        "cost of a view at the gate of its place, and of one at that of its size, falling with the square",
        origin=SET,
        expert=True,
        low=0,
    )
    miss_cost: float = setting(
        0.7,
        "log odds",
        "cost of a frame that should show the panel and has no candidate there",
        origin=SET,
        expert=True,
        low=0,
    )
    expected_px: float = setting(
        14.0, "px", "height from which a view is expected", origin=SET, expert=True, low=0
    )


@dataclass(frozen=True, slots=True)
class AcceptanceSettings:
    """Greedy acceptance of hypotheses."""

    least_value: float = setting(
        -1.0,
        "log odds",
        "hypotheses with a smaller sum over their views are dropped",
        origin=SET,
        expert=True,
    )
    rounds: int = setting(
        3,
        "",
        "fits of a hypothesis to its views before the last one, at most",
        origin=SET,
        expert=True,
        low=1,
    )


@dataclass(frozen=True, slots=True)
class MappingSettings:
    """The groups that tracking reads, under their names in the tree."""

    track: TrackSettings = field(default_factory=TrackSettings)
    association: AssociationSettings = field(default_factory=AssociationSettings)
    acceptance: AcceptanceSettings = field(default_factory=AcceptanceSettings)
    landmark: LandmarkSettings = field(default_factory=LandmarkSettings)
    verdict: VerdictSettings = field(default_factory=VerdictSettings)
