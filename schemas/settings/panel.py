"""Settings of panels as planes: views, registration, outline, size and facing; and of the local adjustment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from wayside.schemas.settings.field import setting

_expert = partial(setting, expert=True, origin="set by hand, no measurement on record")


@dataclass(frozen=True, slots=True)
class PanelSettings:
    """Which images measure a panel, and how sure its position, size and facing are."""

    most_views: int = _expert(6, "views", "nearest views that measure a panel", low=1)
    smallest_px: float = _expert(9.0, "px", "views of a smaller side are left out", low=1)
    nearest_m: float = _expert(4.0, "m", "nearer views are left out", low=0.1)
    farthest_m: float = _expert(90.0, "m", "farther views are left out", low=1)
    border: float = _expert(1.05, "", "the box times this lies within a usable image", low=1)
    border_px: float = _expert(1.0, "px", "distance of that box from the edge of the image", low=0)
    smallest_strength: float = _expert(
        0.4, "", "edge strength all round (0 to 1) below which an outline is refused", low=0, high=1
    )
    centre_sigma_px: float = _expert(
        0.15, "px", "scatter of a registered centre beyond its covariance", low=1e-4
    )
    stretch_sigma: float = _expert(
        0.003,
        "",
        "relative scatter of a registered stretch beyond its covariance: motion from view to view",
        low=1e-4,
    )
    blur_sigma: float = _expert(
        0.025,
        "",
        "relative scatter of the stretch of a view twice as far as the template, by its blur",
        low=0,
    )
    covariance_scale: float = _expert(
        2.0,
        "",
        "factor on the standard deviations of registration, whose residuals do not show moving backgrounds",
        origin="measured; the drives are not on record",
        low=0,
    )
    facing_sigma_deg: float = _expert(
        8.0, "deg", "scatter of the facing of panels along a road (prior)", low=0.01
    )
    aspect_sigma: float = _expert(
        0.02,
        "",
        "relative scatter of the proportion of shapes that have one, outline included",
        low=0.0001,
    )
    facing_iterations: int = _expert(
        6, "steps", "Gauss-Newton steps of size and facing at most", low=1
    )
    facing_converged: float = _expert(
        1e-6, "rad", "steps shorter than this (of the sizes: relative) end them", low=0
    )
    facing_step: float = _expert(
        0.3, "rad", "change in one of these steps at most (of the sizes: relative)", low=1e-3
    )
    farthest_off_m: float = _expert(
        1.0, "m", "a panel farther from its boxes is refused, near by", low=0
    )
    farthest_off: float = _expert(
        0.1, "", "and far off: as a fraction of the depth of the nearest view", low=0
    )


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """Registration of the views of a panel on its plane (Lucas and Kanade 1981; Baker and Matthews 2004)."""

    most_samples: int = _expert(
        150, "samples", "samples across the longer side of a panel at most", low=16
    )
    margin: float = _expert(
        0.35, "", "margin round the box, as a fraction of the shorter side", low=0
    )
    margin_longer: float = _expert(
        0.6, "", "and of the longer side times this, where that is more", low=0
    )
    depth_ratio: float = _expert(
        3.2, "", "views up to so many times farther than the template are registered", low=1
    )
    enough_views: int = _expert(
        2,
        "views",
        "with fewer registered, the next view becomes the template: the nearest may be half hidden",
        low=1,
    )
    most_templates: int = _expert(3, "views", "templates that are tried", low=1)
    zncc: float = _expert(
        0.8, "", "correlation (ZNCC) above which a view counts as registered", low=-1, high=1
    )
    fewest_samples: int = _expert(
        64,
        "samples",
        "samples that are compared at least: a far view mixes a small face with its background",
        low=1,
    )
    full_size_samples: int = _expert(
        90, "samples", "longer patches are registered at half size", low=16
    )
    blur: float = _expert(
        0.45, "samples", "blur (sigma) of the template for a view sqrt(2) times as far", low=0
    )
    smallest_blur: float = _expert(0.2, "samples", "smaller blurs are left out", low=0)
    iterations: int = _expert(12, "steps", "Gauss-Newton steps at most", low=1)
    converged: float = _expert(
        0.005,
        "samples",
        "steps that move all samples by less than this end the registration",
        low=0,
    )
    stretch_sigma: float = _expert(0.03, "", "scatter of the stretches about 1 (prior)", low=0.0001)
    largest_stretch: float = _expert(
        0.2, "", "a stretch that differs more from 1 is refused", low=0
    )
    largest_shift: float = _expert(
        4.0, "samples", "a shift that moves farther from its start is refused", low=0
    )
    inside: float = _expert(
        0.5,
        "",
        "fraction of the weighted samples that lies in the other view at least",
        low=0,
        high=1,
    )
    samples_per_independent: float = _expert(
        3.0, "samples", "neighbouring samples that share a pixel count as one", low=1
    )
    smallest_variance: float = _expert(
        1.0, "grey levels squared", "variance of a sample at least", low=0
    )


@dataclass(frozen=True, slots=True)
class PanelOutlineSettings:
    """The outer outline of a face in registered views; lengths in samples of the template."""

    depth_ratio: float = _expert(
        2.3, "", "views up to so many times farther than the template show the outline", low=1
    )
    most_views: int = _expert(3, "views", "nearest views that show the outline", low=1)
    offset_step: float = _expert(
        0.25, "samples", "between the places where an edge is sought", low=0.05, high=1
    )
    edge_level: float = _expert(
        12.0, "grey levels a sample", "gradient of an edge of strength one half", low=0.1
    )
    segment_samples: int = _expert(
        16, "samples", "points at which a segment is compared at most", low=4
    )
    least_segment_samples: int = _expert(4, "samples", "and at least", low=1)
    inside: float = _expert(
        0.6, "", "fraction of a segment that lies in the views at least", low=0, high=1
    )
    trial_step: float = _expert(
        0.5, "samples", "between the boxes that are tried for the strongest outline", low=0.05
    )
    trial_sweeps: int = _expert(
        3, "sweeps", "over the sides of a box, the first of them over the whole range", low=1
    )
    trial_range: float = _expert(
        2.0, "samples", "range of a side, either way, in the further sweeps", low=0.05
    )
    inward: float = _expert(
        0.12,
        "",
        "the strongest outline lies within the box by this fraction of the smaller side at most",
        low=0,
    )
    outward: float = _expert(0.28, "", "and outside it by this fraction at most", low=0)
    search: float = _expert(3.0, "samples", "and by this either way at least", low=1)
    most_refined: int = _expert(3, "shapes", "shapes that are refined", low=1)
    most_inner: int = _expert(
        2, "shapes", "shapes round whose strongest outline candidates are sought", low=1
    )
    smallest_inward: float = _expert(
        1.5, "samples", "candidates lie within the strongest outline by this at most", low=0
    )
    candidates_outward: float = _expert(
        0.3, "", "and outside it by this fraction of the smaller side", low=0
    )
    weaker_part: float = _expert(
        0.75,
        "",
        "fraction of the segments, the weaker ones, whose mean strength counts: an outline has edges all round",
        low=0.01,
        high=1,
    )
    smallest_edge: float = _expert(
        0.15, "", "fraction of the strongest edge below which a candidate is left out", low=0
    )
    strip: float = _expert(
        1.5, "samples", "width of the strip inside a candidate whose colour should be even"
    )
    strip_samples: int = _expert(
        3, "samples", "along a segment, whose mean is the colour of its strip", low=1
    )
    side_rounds: int = _expert(2, "rounds", "of aligning the profiles of the sides", low=1)
    side_search: float = _expert(
        4.0, "samples", "range of the shift that aligns the sides' profiles", low=1
    )
    side_penalty: float = _expert(
        0.01, "1 / sample", "correlation that a longer shift of a side must gain", low=0
    )
    refine_iterations: int = _expert(
        4, "steps", "of a fit of sides and rotation, and of its weights in each, at most", low=1
    )
    refine_step: float = _expert(
        2.0, "samples", "change of a side in one step at most (of the rotation: rad)", low=0.05
    )
    refine_converged: float = _expert(
        0.02, "samples", "steps shorter than this (of the rotation: rad) end the fit", low=0
    )
    refine_views: int = _expert(2, "views", "nearest views of the last fit", low=1)
    refine_search: float = _expert(1.5, "samples", "range of the edges of the last fit", low=0.5)
    free_search: float = _expert(2.0, "samples", "range of the edges where sides are free", low=0.5)
    side_sigma: float = _expert(
        1.0, "samples", "scatter of a side about its start (prior)", low=0.01
    )
    rival_sigmas: float = _expert(
        4.0, "sigmas", "of a side, either way, within which edges are its rivals", low=0.5
    )
    rotation_sigma_deg: float = _expert(
        1.5, "deg", "scatter of the rotation in the plane (prior)", low=0.01
    )
    aspect_sigma: float = _expert(
        0.03, "", "relative scatter of the proportion of shapes that have one", low=0.0001
    )
    edge_sigma: float = _expert(0.35, "samples", "scatter of the edge of one segment", low=0.01)
    edge_cauchy: float = _expert(
        0.5, "samples", "scale of the Cauchy weight of a segment's residual", low=0.01
    )
    offset_sigma: float = _expert(
        1.0, "samples", "nearer edges of a segment are preferred: sigma of their weight", low=0.1
    )
    weakest_edge: float = _expert(0.05, "", "strength below which a segment has no edge", low=0)
    flank: float = _expert(
        4.0, "samples", "range in which the outer flank of the edge is measured", low=1
    )
    sharp_flank: float = _expert(
        1.7, "samples", "width of a plain edge to half of its height", low=0
    )
    rim_fraction: float = _expert(0.7, "", "fraction of the remaining width that is rim", low=0)
    most_rim_inward: float = _expert(
        0.7, "samples", "the rim moves the outline inwards by this at most", low=0
    )
    most_rim_outward: float = _expert(1.4, "samples", "and outwards by this at most", low=0)


@dataclass(frozen=True, slots=True)
class LocalAdjustmentSettings:
    """A landmark adjusted together with the poses of the frames around it (report chapter 8)."""

    most_frames: int = _expert(8, "frames", "longest window", low=2)
    views_inside: float = _expert(
        0.5,
        "",
        "a window with a smaller fraction of the views is left to the chain of all",
        low=0,
        high=1,
    )
    cell_px: float = _expert(
        70.0, "px", "one tie is kept in each cell of this size, longest tracks first", low=1
    )
    sliding_px: float = _expert(
        0.12,
        "px",
        "ties that may slide further along the edges of their patches are left out",
        low=0,
    )
    displacement_sigma: float = _expert(
        0.002,
        "",
        "scatter of a tie as a fraction of its displacement in the image",
        origin="measured; the drives are not on record",
        low=0,
    )
    tie_scale: float = _expert(1.0, "sigmas", "scale of the robust cost of a tie", low=0.01)
    variance_factor: float = _expert(
        0.85,
        "",
        "variance of normal errors under the robust costs, as a fraction of what the weights say",
        origin="integrals over the normal distribution: 0.83 for rays, 0.86 for ties",
        low=0,
    )
    anchor_sigma_px: float = _expert(
        0.01, "px", "scatter of the first corner of a track: it defines the point", low=1e-4
    )
    nearest_m: float = _expert(1.0, "m", "least depth of a tie at the start", low=0.01)
    farthest_m: float = _expert(2000.0, "m", "largest depth of a tie at the start", low=1)
