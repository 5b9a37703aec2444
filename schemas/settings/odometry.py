"""Settings of tie points and of the motion between images (report chapters 5 to 8)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class FeatureSettings:
    """Key points (report chapter 5)."""

    corners_per_cell: int = setting(3, "corners", "strongest corners kept in each cell", low=1)
    sift: bool = setting(False, "", "SIFT on the candidates (the report's matching)")


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
    pose_sigma_m: float = setting(
        0.03, "m", "standard deviation of a pose where the log states none", expert=True, low=1e-6
    )
    pose_sigma_deg: float = setting(0.1, "deg", "the same of its rotation", expert=True, low=1e-6)
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
    standing_share: float = setting(
        0.4,
        "",
        "share of an image's corners found again at the same place from which the camera has not moved",
        origin="measured: at most 0.26 on drives (demo and real ones), at least 0.43 on images shaken by 1 px, "
        "saved again at JPEG quality 60, or with a third of them moving",
        expert=True,
        low=0.05,
        high=1,
    )
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
    mount_sigma_deg: float = setting(
        1.5,
        "deg",
        "scatter of the direction of travel while the mount is unknown",
        expert=True,
        low=0,
    )
    travel_right_sigma_deg: float = setting(
        0.35,
        "deg",
        "scatter of the direction of travel sideways",
        origin="measured",
        expert=True,
        low=0,
    )
    travel_up_sigma_deg: float = setting(
        0.25, "deg", "scatter of the direction of travel up", origin="measured", expert=True, low=0
    )
    mount_steps: int = setting(3, "steps", "until the mount counts as known", expert=True, low=1)
    mount_memory: int = setting(61, "steps", "that the mount is the median of", expert=True, low=1)
    height_memory: int = setting(
        300, "steps", "that the height above the road is found from", expert=True, low=1
    )
    lane_half_width_m: float = setting(
        3.0, "m", "points further to the side give no height", expert=True, low=0
    )
    lane_reach_m: float = setting(
        18.0, "m", "points further ahead give no height", expert=True, low=0
    )
    lowest_camera_m: float = setting(0.8, "m", "lowest camera above the road", expert=True, low=0)
    highest_camera_m: float = setting(
        3.2,
        "m",
        "highest camera above the road",
        origin="a vehicle ahead can resemble a road further down",
        expert=True,
        low=0,
    )
    height_band: float = setting(
        0.06, "", "relative width of the band of heights that counts as road", expert=True, low=0
    )
    fewest_heights: int = setting(8, "points", "in that band at least", expert=True, low=1)

    # Length of a step by common points
    fewest_common: int = setting(
        5, "points", "common with the step before that give its length", expert=True, low=1
    )
    smallest_parallax_px: float = setting(
        6.0, "px", "smallest displacement of such a point by travel", expert=True, low=0
    )
    common_sigma: float = setting(
        0.004, "", "smallest relative error of the length by common points", expert=True, low=0
    )
    spacing_tolerance: float = setting(
        0.15,
        "",
        "relative deviation of a length from a multiple of the spacing",
        expert=True,
        low=0,
    )
    most_triggers: int = setting(
        5, "triggers", "in one step at most, with its own", expert=True, low=1
    )
    most_dropped: int = setting(
        2, "steps", "in a row that may have lost triggers", expert=True, low=0
    )
    most_doubts: int = setting(
        2, "steps", "in a row for which common points overrule fixes", expert=True, low=0
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
