"""All settings as one tree: one frozen group a stage, and the presets of the report's three generations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from wayside.schemas.settings.balance import BalanceSettings
from wayside.schemas.settings.codes import CodeSettings
from wayside.schemas.settings.detection import CandidateSettings
from wayside.schemas.settings.mapping import LocateSettings, TrackSettings
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.schemas.settings.odometry import FeatureSettings, MotionSettings
from wayside.schemas.settings.reading import ModelSettings, ReadSettings, RunSettings
from wayside.schemas.settings.report import ReportSettings
from wayside.schemas.settings.route import RouteSettings
from wayside.schemas.settings.segmentation import GateSettings, SegmentSettings


@dataclass(frozen=True, slots=True)
class Settings:
    """All groups, one a stage."""

    read: ReadSettings = field(default_factory=ReadSettings)
    balance: BalanceSettings = field(default_factory=BalanceSettings)
    segment: SegmentSettings = field(default_factory=SegmentSettings)
    gate: GateSettings = field(default_factory=GateSettings)
    candidates: CandidateSettings = field(default_factory=CandidateSettings)
    report: ReportSettings = field(default_factory=ReportSettings)
    features: FeatureSettings = field(default_factory=FeatureSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    locate: LocateSettings = field(default_factory=LocateSettings)
    route: RouteSettings = field(default_factory=RouteSettings)
    codes: CodeSettings = field(default_factory=CodeSettings)
    models: ModelSettings = field(default_factory=ModelSettings)
    run: RunSettings = field(default_factory=RunSettings)
    merge: MergeSettings = field(default_factory=MergeSettings)
    changes: ChangeSettings = field(default_factory=ChangeSettings)


REPORT: dict[str, dict[str, Any]] = {
    "read": {"thin_m": 8.0},
    "balance": {"on": False},
    "segment": {"whole_picture": True},
    "gate": {"smallest_px": 50, "largest_px": 20_000},
    "report": {"on": True},
    "motion": {"always_adjust": False},
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
