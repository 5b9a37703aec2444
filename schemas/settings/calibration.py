"""Settings of `wayside calibrate`, and of the check of the calibration in a run.

No table of a run depends on them, only a note does.
"""

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


@dataclass(frozen=True, slots=True)
class SelfCalibrationSettings:
    """Calibration by the drive itself: which images, what is known of the lens before, when a result counts."""

    images: int = _expert(
        12, "images", "of a segment, within which tracks are adjusted together", low=3
    )
    fewest_tracks: int = _expert(
        20, "tracks", "a segment with fewer tracks is left out", origin="set by hand", low=6
    )
    most_images: int = _expert(
        300, "images", "of a log that are used, from its start or --from on", low=3
    )
    principal_point: float = _expert(
        0.006,
        "",
        "scatter of a given principal point, as a fraction of the width",
        origin="boards: 3 px to 20 px of 1280",
        low=1e-6,
    )
    unknown_principal_point: float = _expert(
        0.02,
        "",
        "distance of the principal point from the centre of the image, where no calibration is given",
        origin="KITTI: 1 % to 2.3 % of the width",
        low=1e-6,
    )
    distortion: float = _expert(
        0.3, "", "scatter of k1 and k2 beforehand", origin="lenses of 50 to 90 degrees", low=1e-6
    )
    length: float = _expert(
        0.2,
        "",
        "relative scatter of the lengths of steps: they do not depend on the lens and only fix the scale",
        low=1e-6,
    )
    focal_guesses: tuple[float, ...] = _expert(
        (0.6, 0.9, 1.4),
        "",
        "focal lengths over the width of the image that are tried where no calibration is given",
        origin="80, 58 and 39 degrees across",
        low=0.05,
    )
    rounds: int = _expert(3, "rounds", "of matching anew with the result at most", low=1)
    settled: float = _expert(
        0.02, "", "matching is repeated where the focal length changed by more", low=0
    )
    # How near to its minimum the adjustment ends
    iterations: int = _expert(15, "steps", "of the lens in one fit, at most", low=1)
    start_iterations: int = _expert(
        10, "steps", "of poses and points at the start, before the lens is free, at most", low=1
    )
    inner_iterations: int = _expert(
        4, "steps", "of poses and points after each step of the lens, at most", low=1
    )
    gain: float = _expert(
        0.5,
        "",
        "they end where the cost, twice a logarithm of likelihood, falls by less",
        origin="one standard error changes it by 1",
        low=0,
    )
    longest_step: float = _expert(
        0.1,
        "",
        "change of the focal length in one step at most, relative",
        origin="set by hand",
        low=1e-6,
    )
    reweightings: int = _expert(
        3, "fits", "with the errors of ties as large as the residuals of the last one say", low=1
    )
    same_errors: float = _expert(
        0.95,
        "",
        "the last fit is one after which these errors are at least so many times those before",
        origin="set by hand",
        low=0,
        high=1,
    )
    largest_sigma: float = _expert(
        0.03,
        "",
        "a focal length with a larger relative standard error counts as not determined",
        origin="3 % of focal length is 3 % of every position along the road",
        low=0,
    )
    check_segments: int = _expert(
        3,
        "segments",
        "of a run by which its calibration is checked: those that turn most",
        origin="0.2 s to 0.5 s of computing time each",
        low=1,
    )
    check_error: float = _expert(
        0.03,
        "",
        "a note says that a lens is wrong where a point of the image is displaced by more, relative to its distance "
        "from the principal point",
        origin="as `largest_sigma`",
        low=0,
    )
    check_closer: float = _expert(
        0.5,
        "",
        "the lens is adjusted in full where the first step displaces a point by more than so much of `check_error`",
        origin="the first step falls short of a large error",
        low=0,
        high=1,
    )
    check_sigmas: float = _expert(
        4.0,
        "sigmas",
        "and a chi-square test of focal length, k1 and k2 rejects it at the probability of so many, two-sided",
        origin="set by hand",
        low=0,
    )
