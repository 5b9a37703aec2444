"""After many drives: one inventory of their panels, and what was in view of which drive."""

from wayside.stages.inventory.grouping import combine, face_runs, join_groups, merge_sightings
from wayside.stages.inventory.offsets import DriveOffsets, relative_variance, solve_offsets

__all__ = [
    "DriveOffsets",
    "combine",
    "face_runs",
    "join_groups",
    "merge_sightings",
    "relative_variance",
    "solve_offsets",
]
