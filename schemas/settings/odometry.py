"""Settings of tie points and of the motion between images (report chapters 5 to 8)."""

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class FeatureSettings:
    """Key points (report chapter 5)."""

    corners_per_cell: int = setting(3, "corners", "strongest corners kept in each cell", low=1)


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """Motion between frames (report chapters 7 and 8)."""

    residual_px: float = setting(
        0.0, "px", "straight-line residual above which a pair is adjusted; 0: every pair is", low=0
    )
    smallest_ties: int = setting(
        20, "points", "fewer tie points: the expected step is used, not a measured one", low=5
    )
    spacing_sigma_m: float = setting(
        0.02, "m", "scatter of the distance between triggers", low=0.001
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
