"""Settings of tie points and of the motion between images (report chapters 5 to 8)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class FeatureSettings:
    """Key points (report chapter 5)."""

    corners_per_cell: int = setting(3, "corners", "strongest corners kept in each cell", low=1)


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """Motion between frames (report chapters 7 and 8)."""

    always_adjust: bool = setting(True, "", "adjust every pair, not only those of high residual")
    residual_px: float = setting(
        0.5, "px", "straight-line residual above which a pair is adjusted", low=0
    )
    smallest_ties: int = setting(
        20, "points", "fewer tie points: the step is not measured, the expected one stands", low=5
    )
    spacing_sigma_m: float = setting(
        0.02, "m", "scatter of the distance between triggers", low=0.001
    )
    spacing_scatter: float = setting(
        0.3,
        "",
        "relative scatter of the distance between images about the stated one, where points show that it varies",
        origin="as of lengths taken from fixes",
        expert=True,
        low=0.01,
    )
    # What is expected of a step
    fix_sigma_m: float = setting(
        1.5, "m", "standard deviation of a fix where the log states none", expert=True, low=1e-6
    )
    fix_step_fraction: float = setting(
        0.2,
        "",
        "error of the distance between two fixes, as a fraction of a fix's: most of it is common to both",
        expert=True,
        low=0,
    )
    pose_slack_px: float = setting(
        12.0, "px", "half width of the search band where poses are given", expert=True, low=0
    )
    rotation_slack_px: float = setting(
        45.0, "px", "the same with the rotation of the step before", expert=True, low=0
    )
    first_slack_px: float = setting(120.0, "px", "the same with neither", expert=True, low=0)
    shortest_m: float = setting(0.02, "m", "shortest step", expert=True, low=0)
    fastest_mps: float = setting(
        150.0, "m/s", "fixes that imply a higher speed have jumped", expert=True, low=1
    )
    jump_sigmas: float = setting(
        3.0,
        "sigmas",
        "by more than so many standard deviations of their distance",
        origin="of normal errors one in 700 lies beyond",
        expert=True,
        low=0,
    )
    acceleration_mps2: float = setting(
        2.0,
        "m/s^2",
        "scatter of the vehicle's acceleration where only the last speed tells the length of a step",
        origin="hard but usual braking is 3 to 4",
        expert=True,
        low=0.01,
    )

    # Mount of the camera on its vehicle

    # Length of a step by common points
    fewest_common: int = setting(
        5, "points", "common with the step before that give its length", expert=True, low=1
    )
    smallest_parallax_px: float = setting(
        6.0, "px", "smallest displacement of such a point by travel", expert=True, low=0
    )
    doubt_sigmas: float = setting(
        3.0, "sigmas", "difference of the two lengths that makes a doubt", expert=True, low=0
    )
    unmeasured_sigma_deg: float = setting(
        1.0, "deg", "rotation of a step without enough ties", expert=True, low=0
    )
    trimmed: float = setting(
        0.9,
        "",
        "fraction of the ties that the residuals are means of",
        expert=True,
        low=0.1,
        high=1,
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
