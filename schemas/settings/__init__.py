"""Every setting: one frozen group a stage, each leaf with unit, meaning, origin and limits.

`setting(default, unit, words, ...)` keeps these with the value, so that `wayside settings`, the TOML reader and
`run.json` need no list of their own. Values of the other presets that differ stand in `REPORT`, `REPORT_2D`
and `REPORT_SHAPE`.
"""

import dataclasses
from typing import Any

from wayside.schemas.settings.detection import (
    BalanceSettings,
    CandidateSettings,
    GateSettings,
    SegmentSettings,
)
from wayside.schemas.settings.mapping import LocateSettings, TrackSettings
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.schemas.settings.odometry import FeatureSettings, MotionSettings
from wayside.schemas.settings.reading import ModelSettings, ReadSettings, RunSettings
from wayside.schemas.settings.report import ReportSettings
from wayside.schemas.settings.route import CodeSettings, RoadsideSettings, RouteSettings

__all__ = [
    "REPORT",
    "REPORT_2D",
    "REPORT_SHAPE",
    "BalanceSettings",
    "CandidateSettings",
    "ChangeSettings",
    "CodeSettings",
    "FeatureSettings",
    "GateSettings",
    "LocateSettings",
    "MergeSettings",
    "ModelSettings",
    "MotionSettings",
    "ReadSettings",
    "RouteSettings",
    "SegmentSettings",
    "Settings",
    "TrackSettings",
]


@dataclasses.dataclass(frozen=True, slots=True)
class Settings:
    """All groups, one a stage."""

    read: ReadSettings = dataclasses.field(default_factory=ReadSettings)
    balance: BalanceSettings = dataclasses.field(default_factory=BalanceSettings)
    segment: SegmentSettings = dataclasses.field(default_factory=SegmentSettings)
    gate: GateSettings = dataclasses.field(default_factory=GateSettings)
    candidates: CandidateSettings = dataclasses.field(default_factory=CandidateSettings)
    report: ReportSettings = dataclasses.field(default_factory=ReportSettings)
    features: FeatureSettings = dataclasses.field(default_factory=FeatureSettings)
    motion: MotionSettings = dataclasses.field(default_factory=MotionSettings)
    track: TrackSettings = dataclasses.field(default_factory=TrackSettings)
    locate: LocateSettings = dataclasses.field(default_factory=LocateSettings)
    roadside: RoadsideSettings = dataclasses.field(default_factory=RoadsideSettings)
    route: RouteSettings = dataclasses.field(default_factory=RouteSettings)
    codes: CodeSettings = dataclasses.field(default_factory=CodeSettings)
    models: ModelSettings = dataclasses.field(default_factory=ModelSettings)
    run: RunSettings = dataclasses.field(default_factory=RunSettings)
    merge: MergeSettings = dataclasses.field(default_factory=MergeSettings)
    changes: ChangeSettings = dataclasses.field(default_factory=ChangeSettings)


REPORT: dict[str, dict[str, Any]] = {
    "read": {"thin_m": 8.0},
    "balance": {"on": False},
    "gate": {"smallest_px": 50, "largest_px": 20_000},
    "report": {"on": True},
    "motion": {"residual_px": 0.5},
    "locate": {"smallest_side_m": 0.0, "largest_side_m": 100.0},
}
"""Preset `report`, the report's last chain: its own choices where they differ from the defaults."""

REPORT_2D: dict[str, dict[str, Any]] = REPORT | {
    "report": {"on": True, "trajectory": "image"},
    "locate": {"gate": False},
}
"""Preset `report-2d`: the trajectory of the tracked feature in the image decides (chapter 5), not the location."""

REPORT_SHAPE: dict[str, dict[str, Any]] = REPORT | {
    "report": {"on": True, "shape": True},
    "locate": {"gate": False},
}
"""Preset `report-shape`: the shape of the outline decides (chapter 4)."""
