"""Settings of the path in the world frame and on the globe, and of the signs placed on it."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class GeoreferenceSettings:
    """The path smoothed over the whole drive, and the signs on it."""

    # relative motion between neighbouring frames
    acceleration_mps2: float = setting(
        1.0,
        "m/s^2",
        "standard deviation of the acceleration, where lengths of steps are compared by their times",
        origin="ordinary driving",
        expert=True,
        low=1e-3,
    )
    stamp_s: float = setting(
        2e-3, "s", "scatter of capture times", origin="recorded logs", expert=True, low=1e-6
    )
    equal_length_sigma: float = setting(
        0.1,
        "",
        "relative scatter of a step's length against the one before, where times do not tell",
        origin="estimate",
        expert=True,
        low=1e-3,
    )
    ratio_sigma: float = setting(
        0.0015,
        "",
        "smallest relative scatter of the length ratio of neighbouring steps by common points",
        origin="measured on rendered drives",
        expert=True,
        low=1e-6,
    )
    ratio_fraction: float = setting(
        0.2,
        "",
        "fraction of a ratio's stated scatter that counts: an error of one step's points enters two ratios with "
        "opposite signs and cancels over many steps",
        origin="measured on rendered drives",
        expert=True,
        low=0,
        high=1,
    )
    ratio_limit: float = setting(
        3.0,
        "",
        "length ratios above this or below its inverse are ignored",
        origin="estimate",
        expert=True,
        low=1,
    )
    along_sigma_m: float = setting(
        2e-3,
        "m",
        "scatter of a step along itself where its length is an unknown of the adjustment",
        origin="small against every other error",
        expert=True,
        low=1e-6,
    )
    step_floor_m: float = setting(
        1e-3, "m", "smallest scatter of a step", origin="estimate", expert=True, low=1e-6
    )
    step_floor_rad: float = setting(
        1e-5,
        "rad",
        "smallest scatter of a step's rotation",
        origin="estimate",
        expert=True,
        low=1e-8,
    )
    known_length_sigma: float = setting(
        1e-4,
        "",
        "relative scatter of the scale of a step whose length is measured",
        origin="holds it at 1",
        expert=True,
        low=1e-8,
    )
    unknown_length_sigma: float = setting(
        0.3,
        "",
        "relative scatter of the scale of a step whose length was first taken from fixes, points or the last speed",
        origin="estimate",
        expert=True,
        low=1e-3,
    )
    # absolute measurements: poses and fixes of the log
    correlation_s: float = setting(
        60.0,
        "s",
        "correlation time of the error of fixes (atmosphere, orbits, reflections)",
        origin="usual for single receivers",
        expert=True,
        low=0.1,
    )
    white_fraction: float = setting(
        0.1,
        "",
        "part of the stated scatter of a fix that is independent of the fix before",
        origin="estimate",
        expert=True,
        low=0,
        high=1,
    )
    white_m: float = setting(
        0.02,
        "m",
        "smallest independent scatter of a fix",
        origin="carrier phase receivers",
        expert=True,
        low=1e-4,
    )
    up_factor: float = setting(
        1.6,
        "",
        "scatter of heights over that of level positions, where the log does not say",
        origin="usual satellite geometry",
        expert=True,
        low=1,
    )
    origin_reach_deg: float = setting(
        1.0,
        "deg",
        "a fix farther than this from the median of all is not taken as the origin",
        origin="receivers that start up report other continents",
        expert=True,
        low=0.01,
    )
    first_tilt_deg: float = setting(
        5.0,
        "deg",
        "scatter of pitch and roll of the first camera where nothing but fixes is given",
        origin="estimate",
        expert=True,
        low=0.01,
    )
    world_tilt_deg: float = setting(
        0.5,
        "deg",
        "scatter of the tilt of the log's own world against the level of the globe",
        origin="estimate",
        expert=True,
        low=0.001,
    )
    roll_deg: float = setting(
        10.0,
        "deg",
        "scatter of each camera's roll, that of its mount included, where nothing but fixes is given",
        origin="estimate",
        expert=True,
        low=0.1,
    )
    poses_drift_m: float = setting(
        0.02,
        "m",
        "drift of the log's poses against the globe after a metre; grows with the root of the distance",
        origin="estimate",
        expert=True,
        low=0,
    )
    poses_drift_deg: float = setting(
        0.002, "deg", "the same of their rotation", origin="estimate", expert=True, low=0
    )
    odometry_drift_m: float = setting(
        0.1,
        "m",
        "drift of the log's odometry against the globe after a metre; grows with the root of the distance",
        origin="estimate",
        expert=True,
        low=0,
    )
    odometry_drift_deg: float = setting(
        0.02, "deg", "the same of its rotation", origin="estimate", expert=True, low=0
    )
    # the adjustment
    iterations: int = setting(
        50, "iterations", "at most this many of Gauss-Newton", expert=True, low=1
    )
    converged_m: float = setting(
        1e-4, "m", "no camera centre moves further: converged", expert=True, low=1e-9
    )
    offset_sigma_s: float = setting(
        0.5,
        "s",
        "prior scatter of the time offset between poses or fixes and frames",
        origin="estimate",
        expert=True,
        low=1e-3,
    )
    offset_drift_s: float = setting(
        1e-5,
        "s",
        "scatter of its change from frame to frame",
        origin="holds it constant",
        expert=True,
        low=1e-9,
    )
    offset_sigmas: float = setting(
        4.0,
        "sigma",
        "a time offset is undone where it exceeds so many of its standard deviations",
        origin="no offset is found on rendered drives without one",
        expert=True,
        low=1,
    )
    smallest_offset_s: float = setting(
        0.02, "s", "shorter time offsets are ignored", origin="estimate", expert=True, low=0
    )
    step_reach: float = setting(
        6.0,
        "sigma",
        "residual of a step at which its Cauchy weight is one half",
        expert=True,
        low=0.1,
    )
    ratio_reach: float = setting(6.0, "sigma", "the same of a length ratio", expert=True, low=0.1)
    position_reach: float = setting(3.0, "sigma", "the same of a pose or fix", expert=True, low=0.1)
    jump_weight: float = setting(
        0.3,
        "",
        "poses and fixes of lower weight are excluded before the correlated error is estimated: it would follow a jump",
        origin="made-up drives with jumps",
        expert=True,
        low=0,
        high=1,
    )
    excluded_weight: float = setting(
        1e-6, "", "their weight", origin="not singular", expert=True, low=0, high=1
    )
    outlier_weight: float = setting(
        0.05,
        "",
        "poses and fixes of lower final weight are reported as outliers",
        expert=True,
        low=0,
        high=1,
    )
    heading_step_m: float = setting(
        1.0,
        "m",
        "without poses and fixes, x of the world points along the first displacement longer than this",
        expert=True,
        low=0,
    )
    # notes in run.json
    gap_s: float = setting(
        10.0, "s", "longer gaps between poses or fixes are reported", expert=True, low=0
    )
    jump_m: float = setting(0.5, "m", "shorter jumps are not reported", expert=True, low=0)
    jump_factor: float = setting(
        8.0,
        "",
        "a reported jump exceeds the median disagreement of neighbouring frames by this factor",
        expert=True,
        low=1,
    )
    # signs on the path
    scale_steps: int = setting(
        3,
        "steps",
        "a sign is scaled as this many steps up to its best frame: its distance depends on these",
        expert=True,
        low=1,
    )
    scale_fraction: float = setting(
        0.9,
        "",
        "at most this part of a sign's variance along its ray is taken for that of the steps",
        origin="leaves a covariance",
        expert=True,
        low=0,
        high=0.99,
    )
    frames_before: int = setting(
        3,
        "frames",
        "used frames before the best one in which the camera may pass a sign",
        expert=True,
        low=0,
    )
    frames_after: int = setting(20, "frames", "the same from the best one on", expert=True, low=1)
