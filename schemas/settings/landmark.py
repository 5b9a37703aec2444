"""Settings of landmarks: measurement, verdicts, location and assembly (report chapters 7, 8 and 11)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import SET, setting


@dataclass(frozen=True, slots=True)
class LandmarkSettings:
    """Errors of boxes and of motion, and the measurement of a landmark."""

    centre_sigma_px: float = setting(
        1.0, "px", "scatter of the centre of a box", origin=SET, expert=True, low=0.01
    )
    centre_sigma_share: float = setting(
        0.02,
        "heights",
        "added to it: some boxes follow the inner field of a face",
        origin=SET,
        expert=True,
        low=0,
    )
    drift_rad: float = setting(
        2.5e-4,
        "rad",
        "scatter of a ray, times the root of the frames to the nearest view: chained motion",
        origin=SET,
        expert=True,
        low=0,
    )
    fitted_views: int = setting(
        8,
        "views",
        "nearest views that the point is fitted to",
        origin="more add nothing (measured)",
        expert=True,
        low=2,
    )
    nearest_m: float = setting(
        1.0,
        "m",
        "rays that meet nearer are not believed",
        origin="no panel is so near",
        expert=True,
        low=0,
    )
    farthest_m: float = setting(
        1000.0, "m", "rays that meet farther are parallel", origin=SET, expert=True, low=1
    )
    size_views: int = setting(
        6, "views", "nearest views whose median is the size", origin=SET, expert=True, low=1
    )
    least_spread: float = setting(
        0.02, "", "least scatter of the size, by the size", origin=SET, expert=True, low=0
    )
    step_sigma_rad: float = setting(
        2e-4, "rad", "rotation of a step of unknown scatter", origin=SET, expert=True, low=0
    )
    step_sigma_right_m: float = setting(
        0.01, "m", "the same, sideways", origin=SET, expert=True, low=0
    )
    step_sigma_down_m: float = setting(
        0.005, "m", "the same, up and down", origin=SET, expert=True, low=0
    )
    step_sigma_ahead_m: float = setting(
        0.025, "m", "the same, ahead", origin=SET, expert=True, low=0
    )

    @property
    def step_sigma(self) -> tuple[float, ...]:
        """Scatter of a step whose covariance is not known: rotation vector (rad), then right, down, ahead (m)."""
        turn = self.step_sigma_rad
        metres = (self.step_sigma_right_m, self.step_sigma_down_m, self.step_sigma_ahead_m)
        return (turn, turn, turn, *metres)


@dataclass(frozen=True, slots=True)
class VerdictSettings:
    """Verdicts on landmarks while they are tracked."""

    swept_half_width_m: float = setting(
        1.3, "m", "half width of what the vehicle sweeps", origin="size of a vehicle", expert=True
    )
    swept_height_m: float = setting(
        2.0, "m", "height of that above the camera", origin="size of a vehicle", expert=True
    )


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """Classification by location, and what is reported."""

    gate: bool = setting(
        True, "", "refuse landmarks where no sign stands, and of no sign's size; false: keep all"
    )
    confidence: float = setting(
        0.5,
        "",
        "signs below this confidence get status uncertain; with a false-alarm rate (models.alpha), 0.5 stands for the "
        "confidence that it asks for",
        low=0,
        high=1,
    )
    smallest_side_m: float = setting(
        0.12, "m", "panels with a smaller side are refused", low=0, high=10
    )
    largest_side_m: float = setting(
        12.0, "m", "panels with a larger side are refused", low=0, high=100
    )


@dataclass(frozen=True, slots=True)
class AssemblySettings:
    """Panels on one support, and panels measured twice."""

    support_m: float = setting(
        0.6,
        "m",
        "panels of one support are nearer than this, with less between them",
        origin=SET,
        expert=True,
        low=0,
    )
    same_share: float = setting(
        0.4,
        "sizes",
        "centres nearer than this are one panel's",
        origin=SET,
        expert=True,
        low=0,
    )
    along_sigmas: float = setting(
        2.5, "sigmas", "tolerance along the path", origin=SET, expert=True, low=0
    )
    along_most_m: float = setting(
        2.0, "m", "largest tolerance along the path", origin=SET, expert=True, low=0
    )
    remember_m: float = setting(
        60.0,
        "m",
        "stretch of path over which landmarks are compared",
        origin="longer than the window",
        expert=True,
        low=0,
    )
