"""The motion stage: which images of a drive show motion, and the camera's motion between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from wayside.schemas.detections import NOTHING_DROPPED, Candidates, Detections, Regions
from wayside.schemas.frame import DUPLICATE, Image
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import MotionSettings
from wayside.stages.odometry.tie_points import GUIDED_RATIO, SEARCH_PX, KeypointImage, match_around
from wayside.stages.odometry.visual_odometry import VisualOdometry

STANDING_SHARE = 0.4
"""Share of corners found again in place of a camera that stands: drives show 0.26 at most, shaken images 0.43."""


def estimate_motion(
    images: Iterator[Detections], settings: MotionSettings
) -> Iterator[PosedDetections]:
    """Add the camera's motion to each image.

    Frames that are not used pass with motion None. The first used frame is the origin of the drive's own frame. An
    image that shows no motion since the last used one becomes a frame with the status `duplicate`, without candidates.
    Rays of both have no baseline, and a panel would get the same measurement twice. Slow motion adds up, since images
    are compared with the one that was used last.

    Raises
    ------
    InputError
        Where no source gives the length of a step.
    """
    odometry = VisualOdometry(settings)
    for item in images:
        if not item.frame.used:
            yield PosedDetections(item, None)
            continue
        image = KeypointImage.of(item)
        if shows_no_motion(odometry.image, image, settings):
            yield PosedDetections(_left_out(item), None)
        else:
            yield PosedDetections(item, odometry.advance(image, item.frame))


def shows_no_motion(
    before: KeypointImage | None, now: KeypointImage | None, settings: MotionSettings
) -> bool:
    """Whether enough corners of an image are found again at the same place to show that the camera stands.

    This needs no prior: a wrong pose or spacing does not hide a copy. Travel moves most corners, and leaves only those
    that are far away, or on the vehicle itself; corners on other vehicles move while the camera stands. False where an
    image has too few corners to tell.
    """
    if before is None or now is None or before.grey.shape != now.grey.shape:
        return False
    most = min(len(before.corners), len(now.corners))
    if most < settings.smallest_ties:
        return False
    again = match_around(before, now, SEARCH_PX, GUIDED_RATIO)
    return len(again) >= STANDING_SHARE * most


def _left_out(item: Detections) -> Detections:
    """An image that takes no part, without pixels and candidates; the number of its regions stays.

    So none is lost uncounted. Recorded bytes go as well: where a vehicle stands, any number of duplicates waits behind
    the tracking window.
    """
    frame = replace(item.frame, status=DUPLICATE, data=b"")
    segmentation = replace(
        item.segmentation,
        image=Image(frame, None, None),
        regions=Regions.empty(),
        dropped=NOTHING_DROPPED,
    )
    return Detections(segmentation, Candidates.of(Regions.empty()))
