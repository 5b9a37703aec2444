"""Settings of merging drives into one inventory and of comparing surveys. No run of a drive depends on them."""

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class MergeSettings:
    """When sightings of several drives are of one panel, and how the errors of the drives' fixes go together."""

    cell_zoom: int = setting(
        14, "", "zoom level of the quadkeys that the tables are parted by", low=1, high=20,
        origin="about 2 km: some hundred panels a file",
    )  # fmt: skip
    drives_in_memory: int = setting(
        256, "drives", "tables of so many drives are held at a time", low=1,
        origin="drives that cross neighbouring cells; 256 of 300 signs each take 70 MB",
    )  # fmt: skip
    reach_m: float = setting(
        30.0, "m", "sightings farther apart are never compared", low=0.1,
        origin="four standard deviations between two drives with fixes of 5 m",
    )  # fmt: skip
    missed: float = setting(
        0.1, "", "probability that a drive does not find a panel whose front it passes", low=1e-3, high=1.0,
        origin="rendered drives held out: 3 %; roads are harder",
    )  # fmt: skip
    change_per_year: float = setting(
        0.08, "1/year", "probability that the face at a place is replaced by another one within a year", low=1e-6,
        high=0.9, origin="a sign lasts about twelve years",
    )  # fmt: skip
    support_m: float = setting(
        0.6, "m", "panels nearer than this on the ground stand on one support", low=0,
        origin="as within a drive",
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ChangeSettings:
    """When a place was in view of a drive, and when a panel has moved."""

    farthest_m: float = setting(
        400.0, "m", "images taken farther from a place are not looked at", low=1,
        origin="no face is measured from farther away",
    )  # fmt: skip
    moved_m: float = setting(
        30.0, "m", "a panel that is gone and one of the same face that is new so far apart are one that was moved",
        low=0, origin="shorter than the distance of equal signs along a road",
    )  # fmt: skip
    images: int = setting(
        8, "images", "whether a drive saw past a place is told by so many of its largest images of it", low=2,
        origin="set by hand: all of them are read and decoded",
    )  # fmt: skip
