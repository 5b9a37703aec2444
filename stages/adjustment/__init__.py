"""Bundle adjustment of frames and points together (report chapter 8)."""

from wayside.stages.adjustment.bundle_adjustment import WindowAdjustment, adjust_window
from wayside.stages.adjustment.residuals import QUADRATIC, ResidualBlocks, StepConstraints

__all__ = [
    "QUADRATIC",
    "ResidualBlocks",
    "StepConstraints",
    "WindowAdjustment",
    "adjust_window",
]
