"""Settings of tie points and of the relative pose of two images (report chapters 6 to 8)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class TieSettings:
    """Matching, registration and robust fits of one pair of images."""

    # Matches of descriptors
    coarse_bits: int = setting(
        64, "bits", "largest descriptor distance of a coarse match", expert=True, low=0, high=256
    )
    coarse_ratio: float = setting(
        0.85, "", "largest ratio of best to second descriptor distance, coarse", expert=True, low=0
    )
    guided_bits: int = setting(
        80, "bits", "largest descriptor distance along an epipolar line", expert=True, low=0
    )
    guided_ratio: float = setting(
        0.92, "", "largest ratio of best to second distance on the line", expert=True, low=0
    )
    guided_width_px: float = setting(
        4.0, "px", "half width of the band along an epipolar line", expert=True, low=0
    )
    wide_slack_px: float = setting(
        160.0,
        "px",
        "half width of the band of the fit that gives another start",
        expert=True,
        low=0,
    )
    same_corner_px: float = setting(
        6.0, "px", "matches this near to the best are no second best", expert=True, low=0
    )
    largest_growth: float = setting(
        2.6, "", "largest growth of an object from image to image", expert=True, low=1
    )
    smallest_growth: float = setting(
        0.8, "", "smallest growth of a patch from image to image", expert=True, low=0
    )
    longest_px: float = setting(500.0, "px", "longest displacement by travel", expert=True, low=0)
    near_epipole_px: float = setting(
        20.0, "px", "nearer to the epipole the growth is not measurable", expert=True, low=0
    )
    near_epipole_growth: float = setting(1.1, "", "growth assumed there", expert=True, low=0)
    cell_px: float = setting(100.0, "px", "side of a cell of the image", expert=True, low=1)
    per_cell: int = setting(6, "matches", "registered in each cell at most", expert=True, low=1)

    # Registration of patches
    search_px: int = setting(
        2, "px", "whole-pixel search round the expected position", expert=True, low=0
    )
    road_search_px: int = setting(3, "px", "the same, on the road", expert=True, low=0)
    farthest_px: float = setting(
        3.0, "px", "largest shift from where it is expected, besides the search", expert=True, low=0
    )
    scale_change: float = setting(1.3, "", "largest change of scale by the fit", expert=True, low=1)
    registration_iterations: int = setting(12, "iterations", "at most", expert=True, low=1)
    converged_px: float = setting(
        0.01, "px", "a smaller step ends the registration", expert=True, low=0
    )
    least_texture: float = setting(
        2.0, "grey levels", "smallest standard deviation of a patch", expert=True, low=0
    )
    abandoned_correlation: float = setting(
        0.3, "", "a registration below it is abandoned", expert=True, low=-1, high=1
    )
    smallest_correlation: float = setting(
        0.85, "", "smallest correlation of a registered patch", expert=True, low=0.01, high=1
    )

    # Points on the road
    road_gap_px: float = setting(
        3.0, "px", "a match so near to the road's prediction lies on it", expert=True, low=0
    )
    road_gap_fraction: float = setting(
        0.1, "", "added to that, as a fraction of the displacement", expert=True, low=0
    )
    nearest_road_m: float = setting(
        4.0, "m", "nearest road point, after the step", expert=True, low=0
    )
    farthest_road_m: float = setting(35.0, "m", "farthest road point", expert=True, low=0)
    road_half_width_m: float = setting(
        5.0, "m", "farthest road point to the side", expert=True, low=0
    )

    scale_step: float = setting(
        0.2,
        "",
        "change of scale in one step of the fit at most, relative",
        origin="set by hand",
        expert=True,
        low=0.001,
    )

    # Errors of ties
    sigma_px: float = setting(
        0.08,
        "px",
        "standard deviation of a registered coordinate",
        origin="measured",
        expert=True,
        low=0.001,
    )
    correlated_sigma_px: float = setting(
        0.05,
        "px",
        "standard deviation of the error that neighbouring ties share",
        origin="scatter of rotations and directions, measured",
        expert=True,
        low=0,
    )
    correlated_fraction: float = setting(
        0.004,
        "",
        "added to that, as a fraction of the displacement by travel",
        origin="measured",
        expert=True,
        low=0,
    )
    correlation_reach_px: float = setting(
        60.0, "px", "reach of the correlation", origin="measured", expert=True, low=1
    )
    scatter_quantile: float = setting(
        0.75,
        "",
        "quantile of the residuals of a step's ties, over the normal one, that raises their stated errors",
        origin="steps against the truth: the median raises the errors of directions too little",
        expert=True,
        low=0.01,
        high=0.99,
    )

    # Fits of a relative pose to rays
    fit_iterations: int = setting(15, "iterations", "of a fit, at most", expert=True, low=1)
    fit_gain: float = setting(
        1e-7,
        "",
        "a fit ends where an iteration lowers the cost by a smaller fraction",
        expert=True,
        low=0,
    )

    # Coarse relative pose, from matched corners
    coarse_sigma_px: float = setting(
        1.0, "px", "standard deviation of a matched corner", expert=True, low=0.01
    )
    coarse_first_scale_px: float = setting(
        20.0, "px", "Cauchy scale of the first fit", expert=True, low=0.01
    )
    coarse_second_scale_px: float = setting(
        5.0, "px", "Cauchy scale of the second fit", expert=True, low=0.01
    )
    coarse_last_scale_px: float = setting(
        1.5, "px", "Cauchy scale of the last fit", expert=True, low=0.01
    )
    coarse_inlier_px: float = setting(
        3.0, "px", "Sampson distance of an inlier, coarse", expert=True, low=0
    )
    fewest_coarse: int = setting(8, "matches", "fewest for a fit", expert=True, low=5)
    held_direction_deg: float = setting(
        0.1, "deg", "standard deviation of a direction of travel that is held", expert=True, low=0
    )

    # Fine relative pose, from registered ties
    fine_first_scale_px: float = setting(
        0.6, "px", "Cauchy scale of the first fine fit", expert=True, low=0.01
    )
    fine_last_scale_px: float = setting(
        0.24, "px", "Cauchy scale of the last fine fit", expert=True, low=0.01
    )
    inlier_px: float = setting(0.4, "px", "Sampson distance of an inlier, fine", expert=True, low=0)
    inlier_ratio: float = setting(
        0.75, "", "below it other starts are tried", expert=True, low=0, high=1
    )
    settled_deg: float = setting(
        0.1, "deg", "ties are registered again while the direction changes more", expert=True, low=0
    )
    rounds: int = setting(3, "rounds", "of registration at most", expert=True, low=1)
    start_yaw_step_deg: float = setting(
        0.3, "deg", "step of the yaws from which ties are registered again", expert=True, low=0
    )
    start_yaws: int = setting(
        3, "yaws", "of these on either side of the prediction", expert=True, low=0
    )
