"""Every setting: one frozen group a stage, each leaf with a unit and a line of words.

`setting(default, unit, words)` keeps both beside the value, so that `wayside settings`, the TOML reader and
`run.json` need no list of their own. Values of the preset `report` that differ stand in `REPORT`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


def setting(
    default: Any,
    unit: str,
    words: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """A dataclass field that knows its unit, meaning and what it may hold (limits included)."""
    return field(
        default=default,
        metadata={"unit": unit, "words": words, "low": low, "high": high, "choices": choices},
    )


@dataclass(frozen=True, slots=True)
class ReadSettings:
    """Which pictures of the log take part."""

    camera: str = setting("", "topic", "picture topic to use; empty: the only one there is")
    calibration: str = setting(
        "", "file", "ROS camera_info YAML that replaces the log's calibration"
    )
    spacing_m: float = setting(
        0.0, "m", "distance between pictures where the log has no poses; 0: unknown", low=0
    )
    thin_m: float = setting(
        8.0, "m", "pictures are thinned to about this distance; 0: use every picture", low=0
    )
    from_s: float = setting(0.0, "s", "start this long after the first picture", low=0)
    until_s: float = setting(
        0.0, "s", "stop this long after the first picture; 0: at the end", low=0
    )
    every: int = setting(1, "pictures", "use every n-th picture only", low=1)


@dataclass(frozen=True, slots=True)
class SegmentSettings:
    """Two-pass K-means (report chapter 2)."""

    clusters: int = setting(16, "colours", "k of pass one", low=2, high=16)
    difference_clusters: int = setting(
        16, "classes", "k of pass two, on the difference image", low=2, high=16
    )
    whole_picture: bool = setting(
        False, "", "segment the whole picture instead of the band where signs can be"
    )


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Size gate (report section 3.1)."""

    smallest_px: int = setting(50, "px", "regions of fewer pixels are dropped", low=1)
    largest_px: int = setting(200_000, "px", "regions of more pixels are dropped", low=1)


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


@dataclass(frozen=True, slots=True)
class FeatureSettings:
    """Key points (report chapter 5)."""

    corners_per_cell: int = setting(
        3, "corners", "strongest corners kept in each 50 px cell", low=1
    )
    sift: bool = setting(False, "", "SIFT on the candidates (the report's matching)")


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """Motion between frames (report chapters 7 and 8)."""

    always_adjust: bool = setting(True, "", "adjust every pair, not only those of high residual")
    residual_px: float = setting(
        0.5, "px", "straight-line residual above which a pair is adjusted", low=0
    )
    smallest_ties: int = setting(
        20, "points", "fewer tie points: the prior is kept as it is", low=5
    )
    spacing_sigma_m: float = setting(
        0.02, "m", "scatter of the distance between triggers", low=0.001
    )
    antenna_right_m: float = setting(
        0.0, "m", "antenna of the fixes to the right of the camera, in its axes", low=-30, high=30
    )
    antenna_down_m: float = setting(
        0.0, "m", "antenna below the camera; above it is negative", low=-30, high=30
    )
    antenna_ahead_m: float = setting(
        0.0, "m", "antenna ahead of the camera; behind it is negative", low=-30, high=30
    )

    @property
    def antenna_m(self) -> tuple[float, float, float]:
        """The antenna in the camera's axes: right, down, ahead."""
        return self.antenna_right_m, self.antenna_down_m, self.antenna_ahead_m


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


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """Learned numbers: colours, shapes, places and judges."""

    folder: str = setting(
        "", "folder", "model files here replace those that ship, each by its name; empty: none"
    )


@dataclass(frozen=True, slots=True)
class RunSettings:
    """How the work is carried out; nothing here changes a result."""

    workers: int = setting(2, "threads", "pictures looked at side by side", low=1, high=64)
    queue: int = setting(4, "frames", "frames waiting at most for each worker", low=1, high=1000)


@dataclass(frozen=True, slots=True)
class Settings:
    """All groups, one a stage."""

    read: ReadSettings = field(default_factory=ReadSettings)
    segment: SegmentSettings = field(default_factory=SegmentSettings)
    gate: GateSettings = field(default_factory=GateSettings)
    candidates: CandidateSettings = field(default_factory=CandidateSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    locate: LocateSettings = field(default_factory=LocateSettings)
    models: ModelSettings = field(default_factory=ModelSettings)
    run: RunSettings = field(default_factory=RunSettings)


REPORT: dict[str, dict[str, Any]] = {
    "segment": {"whole_picture": True},
    "gate": {"smallest_px": 50, "largest_px": 20_000},
    "candidates": {"judge": "report"},
    "features": {"sift": True},
    "motion": {"always_adjust": False},
    "track": {"matching": "sift"},
    "locate": {"beyond": 1e9},
}
"""Preset `report`: the report's own choices where they differ from the defaults."""
