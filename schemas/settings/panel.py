"""Settings of panels as planes: views, registration, outline, size and facing; and of the local adjustment."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting

_MEASURED = "measured on rendered drives"


@dataclass(frozen=True, slots=True)
class PanelSettings:
    """Which images measure a panel, and how sure its position, size and facing are."""

    most_views: int = setting(
        6, "views", "nearest views that measure a panel", origin=_MEASURED, expert=True, low=1
    )
    smallest_px: float = setting(
        9.0, "px", "views of a smaller side are left out", origin=_MEASURED, expert=True, low=1
    )
    nearest_m: float = setting(
        4.0, "m", "nearer views are left out", origin=_MEASURED, expert=True, low=0.1
    )
    farthest_m: float = setting(
        90.0, "m", "farther views are left out", origin=_MEASURED, expert=True, low=1
    )
    border: float = setting(
        1.05, "", "the box times this lies within a usable image", expert=True, low=1
    )
    border_px: float = setting(
        1.0, "px", "distance of that box from the edge of the image", expert=True, low=0
    )
    smallest_strength: float = setting(
        0.4,
        "",
        "edge strength all round (0 to 1) below which an outline is refused",
        origin=_MEASURED,
        expert=True,
        low=0,
        high=1,
    )
    centre_sigma_px: float = setting(
        0.15,
        "px",
        "scatter of a registered centre beyond its covariance",
        origin=_MEASURED,
        expert=True,
        low=0,
    )
    stretch_sigma: float = setting(
        0.003,
        "",
        "relative scatter of a registered stretch beyond its covariance: motion from view to view",
        origin=_MEASURED,
        expert=True,
        low=0,
    )
    blur_sigma: float = setting(
        0.025,
        "",
        "relative scatter of the stretch of a view twice as far as the template, by its blur",
        origin=_MEASURED,
        expert=True,
        low=0,
    )
    covariance_scale: float = setting(
        2.0,
        "",
        "standard deviations of the registration are multiplied by this: residuals know nothing of moving backgrounds",
        origin=_MEASURED,
        expert=True,
        low=0,
    )
    facing_sigma_deg: float = setting(
        8.0,
        "deg",
        "scatter of the facing of panels along a road (prior)",
        origin=_MEASURED,
        expert=True,
        low=0.01,
    )
    aspect_sigma: float = setting(
        0.02,
        "",
        "relative scatter of the proportion of shapes that have one, outline included",
        origin=_MEASURED,
        expert=True,
        low=0.0001,
    )
    farthest_off_m: float = setting(
        1.0, "m", "a panel farther from its boxes is refused, near by", expert=True, low=0
    )
    farthest_off: float = setting(
        0.1, "", "and far off: as a fraction of the depth of the nearest view", expert=True, low=0
    )
    largest_change: float = setting(
        2.5,
        "",
        "a panel larger or smaller than its boxes by this factor is refused",
        expert=True,
        low=1,
    )


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """Registration of the views of a panel on its plane (Lucas and Kanade 1981; Baker and Matthews 2004)."""

    most_samples: int = setting(
        150, "samples", "samples across the longer side of a panel at most", expert=True, low=16
    )
    margin: float = setting(
        0.35, "", "margin round the box, as a fraction of the shorter side", expert=True, low=0
    )
    margin_longer: float = setting(
        0.6, "", "and of the longer side times this, where that is more", expert=True, low=0
    )
    depth_ratio: float = setting(
        3.2,
        "",
        "views up to so many times farther than the template are registered",
        origin=_MEASURED,
        expert=True,
        low=1,
    )
    enough_views: int = setting(
        2,
        "views",
        "with fewer registered, the next view becomes the template: the nearest may be half hidden",
        expert=True,
        low=1,
    )
    most_templates: int = setting(3, "views", "templates that are tried", expert=True, low=1)
    zncc: float = setting(
        0.8,
        "",
        "correlation (ZNCC) above which a view counts as registered",
        origin=_MEASURED,
        expert=True,
        low=-1,
        high=1,
    )
    fewest_samples: int = setting(
        64,
        "samples",
        "samples that are compared at least: a far view mixes a small face with its background",
        expert=True,
        low=1,
    )
    full_size_samples: int = setting(
        90, "samples", "longer patches are registered at half size", expert=True, low=16
    )
    blur: float = setting(
        0.45,
        "samples",
        "blur (sigma) of the template for a view sqrt(2) times as far",
        expert=True,
        low=0,
    )
    smallest_blur: float = setting(0.2, "samples", "smaller blurs are left out", expert=True, low=0)
    iterations: int = setting(12, "steps", "Gauss-Newton steps at most", expert=True, low=1)
    converged: float = setting(
        0.005, "samples", "steps shorter than this end the registration", expert=True, low=0
    )
    stretch_sigma: float = setting(
        0.03, "", "scatter of the stretches about 1 (prior)", expert=True, low=0.0001
    )
    largest_stretch: float = setting(
        0.2, "", "a stretch that differs more from 1 is refused", expert=True, low=0
    )
    largest_shift: float = setting(
        4.0, "samples", "a shift that moves farther from its start is refused", expert=True, low=0
    )
    inside: float = setting(
        0.5,
        "",
        "fraction of the weighted samples that lies in the other view at least",
        expert=True,
        low=0,
        high=1,
    )
    samples_per_independent: float = setting(
        3.0, "samples", "neighbouring samples that share a pixel count as one", expert=True, low=1
    )
    smallest_variance: float = setting(
        1.0, "grey levels squared", "variance of a sample at least", expert=True, low=0
    )


@dataclass(frozen=True, slots=True)
class OutlineSettings:
    """The outer outline of a face in registered views; lengths in samples of the template."""

    depth_ratio: float = setting(
        2.3,
        "",
        "views up to so many times farther than the template show the outline",
        origin=_MEASURED,
        expert=True,
        low=1,
    )
    most_views: int = setting(3, "views", "nearest views that show the outline", expert=True, low=1)
    edge_level: float = setting(
        12.0,
        "grey levels a sample",
        "gradient of an edge of strength one half",
        expert=True,
        low=0.1,
    )
    segment_samples: int = setting(
        16, "samples", "points at which a segment is compared at most", expert=True, low=4
    )
    inside: float = setting(
        0.6, "", "fraction of a segment that lies in the views at least", expert=True, low=0, high=1
    )
    inward: float = setting(
        0.12,
        "",
        "the strongest outline lies within the box by this fraction of the smaller side at most",
        expert=True,
        low=0,
    )
    outward: float = setting(
        0.28, "", "and outside it by this fraction at most", expert=True, low=0
    )
    search: float = setting(3.0, "samples", "and by this either way at least", expert=True, low=1)
    triangle_scale: float = setting(
        1.25, "", "triangles are also started from the box times this", expert=True, low=1
    )
    most_tried: int = setting(
        6, "outlines", "outlines searched again, of all shapes and proportions", expert=True, low=1
    )
    most_refined: int = setting(3, "shapes", "shapes that are refined", expert=True, low=1)
    most_inner: int = setting(
        2,
        "shapes",
        "shapes round whose strongest outline candidates are sought",
        expert=True,
        low=1,
    )
    candidates_inward: float = setting(
        3.0,
        "samples",
        "candidates lie within the strongest outline by this at most",
        expert=True,
        low=1,
    )
    candidates_outward: float = setting(
        0.3, "", "and outside it by this fraction of the smaller side", expert=True, low=0
    )
    smallest_inward: float = setting(
        1.5, "samples", "candidates farther within are left out", expert=True, low=0
    )
    weaker_part: float = setting(
        0.75,
        "",
        "fraction of the segments, the weaker ones, whose mean strength counts: an outline has edges all round",
        expert=True,
        low=0.01,
        high=1,
    )
    smallest_edge: float = setting(
        0.15,
        "",
        "fraction of the strongest edge below which a candidate is left out",
        expert=True,
        low=0,
    )
    shoulder: float = setting(
        0.5, "samples", "shoulders of the profile count from here outwards", expert=True
    )
    strip: float = setting(
        1.5,
        "samples",
        "width of the strip inside a candidate whose colour should be even",
        expert=True,
    )
    side_search: float = setting(
        4.0, "samples", "range of the shift that aligns the sides' profiles", expert=True, low=1
    )
    side_penalty: float = setting(
        0.01,
        "1 / sample",
        "correlation that a longer shift of a side must gain",
        expert=True,
        low=0,
    )
    refine_views: int = setting(2, "views", "nearest views of the last fit", expert=True, low=1)
    refine_search: float = setting(
        1.5, "samples", "range of the edges of the last fit", expert=True, low=0.5
    )
    free_search: float = setting(
        2.0, "samples", "range of the edges where sides are free", expert=True, low=0.5
    )
    side_sigma: float = setting(
        1.0, "samples", "scatter of a side about its start (prior)", expert=True, low=0.01
    )
    rotation_sigma_deg: float = setting(
        1.5, "deg", "scatter of the rotation in the plane (prior)", expert=True, low=0.01
    )
    aspect_sigma: float = setting(
        0.03,
        "",
        "relative scatter of the proportion of shapes that have one",
        expert=True,
        low=0.0001,
    )
    edge_sigma: float = setting(
        0.35,
        "samples",
        "scatter of the edge of one segment",
        origin=_MEASURED,
        expert=True,
        low=0.01,
    )
    edge_cauchy: float = setting(
        0.5, "samples", "scale of the Cauchy weight of a segment's residual", expert=True, low=0.01
    )
    offset_sigma: float = setting(
        1.0,
        "samples",
        "nearer edges of a segment are preferred: sigma of their weight",
        expert=True,
        low=0.1,
    )
    weakest_edge: float = setting(
        0.05, "", "strength below which a segment has no edge", expert=True, low=0
    )
    size_sigma: float = setting(
        0.4,
        "samples",
        "scatter of width and height of a certain outline",
        origin=_MEASURED,
        expert=True,
        low=0,
    )
    flank: float = setting(
        4.0, "samples", "range in which the outer flank of the edge is measured", expert=True, low=1
    )
    sharp_flank: float = setting(
        1.7,
        "samples",
        "width of a plain edge to half of its height",
        origin=_MEASURED,
        expert=True,
        low=0,
    )
    rim_fraction: float = setting(
        0.7, "", "fraction of the remaining width that is rim", origin=_MEASURED, expert=True, low=0
    )
    most_rim_inward: float = setting(
        0.7, "samples", "the rim moves the outline inwards by this at most", expert=True, low=0
    )
    most_rim_outward: float = setting(
        1.4, "samples", "and outwards by this at most", expert=True, low=0
    )


@dataclass(frozen=True, slots=True)
class LocalAdjustmentSettings:
    """A landmark adjusted together with the poses of the frames around it (report chapter 8)."""

    most_frames: int = setting(8, "frames", "longest window", expert=True, low=2)
    views_inside: float = setting(
        0.5,
        "",
        "a window with a smaller fraction of the views is left to the chain of all",
        expert=True,
        low=0,
        high=1,
    )
    cell_px: float = setting(
        70.0,
        "px",
        "one tie is kept in each cell of this size, longest tracks first",
        expert=True,
        low=1,
    )
    sliding_px: float = setting(
        0.12,
        "px",
        "ties that may slide further along the edges of their patches are left out",
        origin=_MEASURED,
        expert=True,
        low=0,
    )
    displacement_sigma: float = setting(
        0.002,
        "",
        "scatter of a tie as a fraction of its displacement in the image",
        origin=_MEASURED,
        expert=True,
        low=0,
    )
    tie_scale: float = setting(
        1.0, "sigmas", "scale of the robust cost of a tie", expert=True, low=0.01
    )
    outlier_sigmas: float = setting(
        4.0, "sigmas", "ties of larger residuals are counted as outliers", expert=True, low=0
    )
    variance_factor: float = setting(
        0.85,
        "",
        "variance of normal errors under the robust costs, as a fraction of what the weights say",
        origin="integrals over the normal distribution: 0.83 for rays, 0.86 for ties",
        expert=True,
        low=0,
    )
    anchor_sigma_px: float = setting(
        0.01,
        "px",
        "scatter of the first corner of a track: it defines the point",
        expert=True,
        low=0,
    )
    nearest_m: float = setting(1.0, "m", "least depth of a tie at the start", expert=True, low=0.01)
    farthest_m: float = setting(
        2000.0, "m", "largest depth of a tie at the start", expert=True, low=1
    )
