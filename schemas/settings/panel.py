"""Settings of panels as planes: views, registration, outline, size and facing; and of the local adjustment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from wayside.schemas.settings.field import setting

_expert = partial(setting, expert=True, origin="set by hand, no measurement on record")


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
