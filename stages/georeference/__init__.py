"""The path of the camera over a whole drive, held by poses and fixes."""

from wayside.stages.georeference.measurements import Chain, Seen
from wayside.stages.georeference.trajectory import Trajectory, smooth

__all__ = [
    "Chain",
    "Seen",
    "Trajectory",
    "smooth",
]
