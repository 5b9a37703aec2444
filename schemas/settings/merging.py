"""Settings of merging drives into one inventory and of comparing surveys. No run of a drive depends on them."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class MergeSettings:
    """When sightings of several drives are of one panel, and how the errors of the drives' fixes go together."""

    cell_zoom: int = setting(
        14, "", "zoom level of the quadkeys that the tables are parted by", low=1, high=20,
        origin="about 2 km: some hundred panels a file",
    )  # fmt: skip
    margin_m: float = setting(
        300.0, "m", "sightings so far outside a cell take part in its merging", low=1,
        origin="longer than supports and gates; offsets beyond tell little about those inside",
    )  # fmt: skip
    drives_in_memory: int = setting(
        256, "drives", "tables of so many drives are held at a time", low=1,
        origin="drives that cross neighbouring cells; 256 of 300 signs each take 70 MB",
    )  # fmt: skip
    common_floor_m: float = setting(
        0.02, "m", "smallest standard deviation of the error common to neighbouring panels of a drive", low=1e-4,
        origin="carrier phase receivers",
    )  # fmt: skip
    correlation_s: float = setting(
        60.0, "s", "correlation time of a drive's common error", low=0.1, origin="as `georeference.correlation_s`",
    )  # fmt: skip
    position_floor_m: float = setting(
        0.02, "m", "smallest standard deviation of a panel relative to the cameras nearby", low=1e-4,
        origin="thickness of a panel and its mount, seen from either side",
    )  # fmt: skip
    probability: float = setting(
        0.9999, "", "two sightings of one panel take part in the adjustment of offsets with this probability "
        "(chi-square, 3)", low=0.5, high=0.9999999, origin="far pairs say nothing of an offset",
    )  # fmt: skip
    kernel: tuple[float, ...] = setting(
        (1.0, 0.5, 0.25, 0.1, 0.05, 0.0), "", "width of the kernel in each iteration of that adjustment, in parts of "
        "the common errors' standard deviation", expert=True, low=0, high=10,
        origin="wide first: signs without a like beside them decide",
    )  # fmt: skip
    reach_m: float = setting(
        30.0, "m", "sightings farther apart are never compared", low=0.1,
        origin="four standard deviations between two drives with fixes of 5 m",
    )  # fmt: skip
    near_sigmas: float = setting(
        4.0, "sigmas", "nor are those farther apart than so many standard deviations of their errors", low=0.1,
        origin="of normal errors one pair in 16,000 lies beyond",
    )  # fmt: skip
    facing_deg: float = setting(
        45.0, "deg", "faces that look in directions farther apart are two panels", low=1, high=180,
        origin="between the scatter of a facing and panels back to back or at a corner",
    )  # fmt: skip
    vector_reach_m: tuple[float, ...] = setting(
        (15.0, 30.0), "m", "a vector by which all panels of two drives differ is looked for up to these lengths, "
        "level, one after the other", low=0.1, origin="datums of one region and base stations differ by metres",
    )  # fmt: skip
    vector_by_chance: float = setting(
        1e-3, "", "it counts where chance makes so many supports agree with a smaller probability", low=1e-12, high=0.5,
        origin="five supports, where few others are near",
    )  # fmt: skip
    tail_freedom: float = setting(
        5.0, "", "degrees of freedom of the Student distribution of a panel's measured position about its place", low=1,
        high=1000, origin="kurtosis 8: that of normal errors of which one in a hundred is four times as large",
    )  # fmt: skip
    density: float = setting(
        0.02, "1/m^3", "other panels around a panel", low=1e-9,
        origin="one more within 50 m^3: panels on one support",
    )  # fmt: skip
    missed: float = setting(
        0.1, "", "probability that a drive does not find a panel whose front it passes", low=1e-3, high=1.0,
        origin="rendered drives held out: 3 %; roads are harder",
    )  # fmt: skip
    misread: float = setting(
        0.03, "", "probability that a drive gives a face another colour, and the same of its shape and size", low=1e-6,
        high=0.5, origin="judgement: of 263 panels on rendered drives held out none; roads are harder",
    )  # fmt: skip
    same_by_chance: float = setting(
        0.3, "", "probability that two panels have the same colour by chance, and the same of the shape", low=1e-3,
        high=0.99, origin="warning, regulatory and guide signs in equal parts",
    )  # fmt: skip
    size_floor: float = setting(
        0.05, "", "smallest relative standard deviation of a width or height", low=1e-3,
        origin="rendered drives held out",
    )  # fmt: skip
    change_per_year: float = setting(
        0.08, "1/year", "probability that the face at a place is replaced by another one within a year", low=1e-6,
        high=0.9, origin="a sign lasts about twelve years",
    )  # fmt: skip
    most_changed: float = setting(
        0.5, "", "that probability at most, however long ago", low=1e-6, high=0.9, expert=True,
        origin="a place whose face is as likely the old as a new one says nothing of either",
    )  # fmt: skip
    support_m: float = setting(
        0.6, "m", "panels nearer than this on the ground stand on one support", low=0,
        origin="as `assembly.support_m`",
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ChangeSettings:
    """When a place was in view of a drive, and when a panel has moved."""

    seen_share: float = setting(
        0.75, "", "share of a drive's panels that were first measured at the height that counts as visible, or less",
        low=0, high=1, origin="the drive's own detection range",
    )  # fmt: skip
    fewest_signs: int = setting(
        5, "signs", "a drive with fewer panels takes `visible_px`", low=1, origin="estimate"
    )
    visible_px: float = setting(
        25.0, "px", "height of a visible face, where the drive does not tell", low=1,
        origin="rendered drives: nearly all faces of 25 px are found",
    )  # fmt: skip
    views: int = setting(
        3, "frames", "a place was in view if a panel there would show in so many images", low=1,
        origin="one more than make a landmark (`track.fewest_views`)",
    )  # fmt: skip
    nearest_m: float = setting(
        1.0, "m", "a place nearer to the camera, along its axis, is not in view", low=0.01,
        origin="no panel is measured from so near",
    )  # fmt: skip
    farthest_m: float = setting(
        400.0, "m", "images taken farther from a place are not looked at", low=1,
        origin="no face is measured from farther away",
    )  # fmt: skip
    oblique_deg: float = setting(
        60.0, "deg", "a face seen at a larger angle from its normal is not in view", low=1, high=90,
        origin="as the truth of rendered drives",
    )  # fmt: skip
    same_size: float = setting(
        0.15, "", "a panel that was moved keeps its width and height to this fraction", low=0,
        origin="three standard deviations of two sizes of 3.5 %",
    )  # fmt: skip
    moved_m: float = setting(
        30.0, "m", "a panel that is gone and one of the same face that is new so far apart are one that was moved",
        low=0, origin="shorter than the distance of equal signs along a road",
    )  # fmt: skip
    images: int = setting(
        8, "images", "whether a drive saw past a place is told by so many of its largest images of it", low=2,
        origin="set by hand: all of them are read and decoded",
    )  # fmt: skip
    correlation: float = setting(
        0.7, "", "of a window with the images before and after, at least, for its distance to count", low=0, high=1,
        origin="set with two rendered roads in view", expert=True,
    )  # fmt: skip
    correlation_margin: float = setting(
        0.1, "", "by which the better of two answers correlates more", low=0, high=1,
        origin="as `changes.correlation`; level edges correlate at any distance", expert=True,
    )  # fmt: skip
    beside: float = setting(
        0.1, "", "what is so much of its distance before or behind a place stands at it", low=0, high=1,
        origin="set by hand: distances are measured over one step, and the place errs", expert=True,
    )  # fmt: skip
