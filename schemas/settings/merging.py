"""Settings of merging drives into one inventory and of comparing surveys. No run of a drive depends on them."""

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class MergeSettings:
    """When sightings from several drives are of one panel, and how errors of the drives' fixes are related."""

    cell_zoom: int = setting(
        14, "", "zoom level of the quadkeys that divide the tables", low=1, high=20,
        origin="about 2 km: some hundred panels a file",
    )  # fmt: skip
    drives_in_memory: int = setting(
        256, "drives", "number of drives whose tables are held at a time", low=1,
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
        400.0, "m", "images taken farther from a place are not used", low=1,
        origin="no face is measured from farther away",
    )  # fmt: skip
    moved_m: float = setting(
        30.0, "m", "a missing panel and a new one with the same face count as moved up to this distance",
        low=0, origin="shorter than the distance of equal signs along a road",
    )  # fmt: skip
    images: int = setting(
        8, "images", "number of a drive's largest images of a place that decide whether it saw past the place", low=2,
        origin="set by hand: all of them are read and decoded",
    )  # fmt: skip
