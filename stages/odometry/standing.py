"""Whether two images were taken from one place: copies of one image, or a vehicle that stands."""

from __future__ import annotations

import numpy as np

from wayside.schemas.settings import MotionSettings, TieSettings
from wayside.stages.odometry.descriptor_matching import match_in_bands
from wayside.stages.odometry.tie_points import KeypointImage


def shows_no_motion(
    before: KeypointImage | None,
    now: KeypointImage | None,
    settings: MotionSettings,
    ties: TieSettings,
) -> bool:
    """Whether so many corners of an image are found again at the same place that the camera cannot have moved.

    This needs no prior: a wrong pose or spacing does not hide a copy. Travel moves most corners, and leaves only those
    that are far away, or on the vehicle itself; corners on other vehicles move while the camera stands. False where an
    image has too few corners to tell.
    """
    if before is None or now is None or before.grey.shape != now.grey.shape:
        return False
    most = min(len(before.corners), len(now.corners))
    if most < settings.smallest_ties:
        return False
    place = before.corners.astype(np.float64)
    here = np.column_stack([place, np.tile([1.0, 0.0, 0.0, ties.search_px], (len(place), 1))])
    again = match_in_bands(
        here,
        before.descriptors,
        now.corners.astype(np.float64),
        now.descriptors,
        farthest=ties.coarse_bits,
        ratio=ties.guided_ratio,
        same_corner_px=ties.same_corner_px,
    )
    return len(again) >= settings.standing_share * most
