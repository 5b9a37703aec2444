"""Every setting: one frozen group a stage, each leaf with unit, meaning, origin and limits.

`setting(default, unit, words, ...)` keeps these beside the value, so that `wayside settings`, the TOML reader and
`run.json` need no list of their own. Values of the other presets that differ stand in `REPORT`, `REPORT_2D`
and `REPORT_SHAPE`.
"""

from wayside.schemas.settings.balance import BalanceSettings
from wayside.schemas.settings.codes import CodeSettings
from wayside.schemas.settings.detection import CandidateSettings
from wayside.schemas.settings.field import setting
from wayside.schemas.settings.mapping import LocateSettings, TrackSettings
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.schemas.settings.odometry import FeatureSettings, MotionSettings
from wayside.schemas.settings.reading import ModelSettings, ReadSettings, RunSettings
from wayside.schemas.settings.report import ReportSettings
from wayside.schemas.settings.route import RouteSettings
from wayside.schemas.settings.segmentation import GateSettings, SegmentSettings
from wayside.schemas.settings.tree import REPORT, REPORT_2D, REPORT_SHAPE, Settings

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
    "ReportSettings",
    "RouteSettings",
    "RunSettings",
    "SegmentSettings",
    "Settings",
    "TrackSettings",
    "setting",
]
