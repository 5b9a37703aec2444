"""Settings of robust least squares: points from several views, and windows of frames (report chapter 8)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class AdjustmentSettings:
    """Triangulation of points and bundle adjustment of windows."""

    cauchy_sigmas: float = setting(
        2.385,
        "sigmas",
        "residual of an observation where its Cauchy cost starts to flatten",
        origin="95 % efficiency on normal errors (Holland and Welsch 1977)",
        expert=True,
        low=0.1,
    )
    point_iterations: int = setting(
        30, "iterations", "of the triangulation of a point, at most", expert=True, low=1
    )
    point_gain: float = setting(
        1e-12,
        "",
        "triangulation ends where an iteration lowers the cost by a smaller fraction",
        expert=True,
        low=0,
    )
    window_iterations: int = setting(
        15,
        "iterations",
        "of the adjustment of a window, at most",
        origin="leaves a position .003 sigmas off the minimum (median; .16 in 95 %)",
        expert=True,
        low=1,
    )
    window_gain: float = setting(
        1e-9,
        "",
        "the adjustment of a window ends where an iteration lowers the cost by a smaller fraction",
        expert=True,
        low=0,
    )
    pair_gain: float = setting(
        1e-4,
        "",
        "the adjustment of two images ends where an iteration lowers the cost by a smaller fraction",
        origin="leaves the motion .01 sigmas off the minimum",
        expert=True,
        low=0,
    )
