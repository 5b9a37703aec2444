"""Settings of `wayside calibrate`: boards. No run depends on them, so they are no part of `run.json`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from wayside.schemas.settings.field import setting

_expert = partial(setting, expert=True)


@dataclass(frozen=True, slots=True)
class BoardSettings:
    """Which views of a board take part in a calibration, and when its result is refused."""

    window: float = _expert(
        0.33,
        "",
        "half side of the window that refines a corner, as a fraction of the distance to the next one",
        origin="measured on rendered boards: corners scatter by 0.04 px, 0.05 px with 0.25, 0.07 px without",
        low=0,
        high=0.5,
    )
    largest_window_px: int = _expert(
        11, "px", "and in pixels at most, as boards are not flat", origin="set by hand", low=2
    )
    fewest_views: int = _expert(
        4,
        "views",
        "views of the board at least",
        origin="two determine a camera without distortion (Zhang 2000); two more to notice a wrong one",
        low=2,
    )
    outlier_ratio: float = _expert(
        3.0,
        "",
        "a view is left out where its residual exceeds that of the median view by this factor",
        origin="set by hand: above the spread of the residuals of the sound views of one camera",
        low=1,
    )
    largest_sigma: float = _expert(
        0.01,
        "",
        "a focal length with a larger relative standard error is refused",
        origin="1 % of focal length is 1 % of every position along the road",
        low=0,
    )
    cells: int = _expert(
        16, "cells", "cells across the image whose corners are counted, for coverage", low=1
    )
