"""The motion stage: which images of a drive take part, and the camera's motion between them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from typing import NamedTuple

from wayside.schemas.detections import NOTHING_DROPPED, Candidates, Detections, Regions
from wayside.schemas.frame import DUPLICATE, OTHER_PLACE, Frame, Image
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import AdjustmentSettings, MotionSettings, TieSettings
from wayside.stages.odometry.image_order import ImageOrder, View, shows_no_motion
from wayside.stages.odometry.tie_points import KeypointImage
from wayside.stages.odometry.visual_odometry import OdometryStep, VisualOdometry


def estimate_motion(
    images: Iterator[Detections],
    settings: MotionSettings,
    ties: TieSettings,
    adjustment: AdjustmentSettings,
) -> Iterator[PosedDetections]:
    """Add the camera's motion to each image.

    Frames that are not used pass with motion None. The first used frame is the origin of the drive's own frame.
    An image that shows no motion since the last used one becomes a frame with the status `duplicate`, without
    candidates: rays of both have no baseline, and a panel would get the same measurement twice. Slow motion adds up,
    since images are compared with the one that was used last.
    An image that shows another place than its order says (`ImageOrder`) becomes one with the status `other_place`; its
    spacing counts for the next. So that the next image can tell, a used image leaves once that one has come.

    Raises
    ------
    InputError
        Where no source gives the length of a step.
    """
    odometry = VisualOdometry(settings, ties, adjustment)
    # State before the newest used image, while that may still be left out, and the spacing of those left out since.
    before_newest: tuple[VisualOdometry, float] | None = None
    gap_m = 0.0
    coming: deque[Detections] = deque()
    past: list[View] = []
    held: list[_Held] = []
    misplaced: set[int] = set()
    while (item := coming.popleft() if coming else next(images, None)) is not None:
        frame, image = item.frame, KeypointImage.of(item) if item.frame.used else None
        step: OdometryStep | None = None
        if frame.used and frame.index in misplaced:
            step = _other_place(frame, misplaced)
        elif shows_no_motion(odometry.image, image, settings, ties):
            step = OdometryStep(None, status=DUPLICATE)
        if not frame.used or (step is not None and step.motion is None):
            if step is not None and step.status == OTHER_PLACE:
                gap_m += frame.spacing_m or 0.0
            held.append(_Held(item, step))
            if before_newest is None:
                yield from _released(held)
            continue
        before, wrong = odometry.copy(), set[int]()
        spacing_m = None if frame.spacing_m is None else frame.spacing_m + gap_m
        odometry.advance(image, replace(frame, spacing_m=spacing_m))
        if image is not None and past and _is_doubtful(odometry, before):
            ahead = _from_here(View(frame, image), images, coming, misplaced, odometry)
            compared = islice(ahead, 1 + settings.order_reach)
            wrong = ImageOrder(before).misplaced(past, compared, certain=before_newest is None)
        if not wrong:
            yield from _released(held)
            before_newest, gap_m = (before, gap_m), 0.0
            past = [] if image is None else [*past[-settings.order_reach :], View(frame, image)]
            held = [_Held(item, odometry.last)]
            continue
        # Go back before the first image that is left out: this one comes again.
        odometry, misplaced = before, misplaced | wrong
        coming.appendleft(item)
        if before_newest is not None and past[-1].frame.index in wrong:
            (odometry, gap_m), before_newest = before_newest, None
            newest = past.pop().frame
            gap_m += newest.spacing_m or 0.0
            held[0] = held[0]._replace(step=_other_place(newest, misplaced))
            yield from _released(held)
    yield from _released(held)


class _Held(NamedTuple):
    """The newest used image or one that has come since."""

    item: Detections
    step: OdometryStep | None


def _released(held: list[_Held]) -> Iterator[PosedDetections]:
    """Let go of all that waits: it is certain."""
    for item, step in held:
        motion = None if step is None else step.motion
        out = item if step is None or motion is not None else _left_out(item, step.status)
        yield PosedDetections(out, motion)
    held.clear()


def _other_place(frame: Frame, misplaced: set[int]) -> OdometryStep:
    later = tuple(sorted(i for i in misplaced if i > frame.index))
    return OdometryStep(None, status=OTHER_PLACE, misplaced=later)


def _is_doubtful(now: VisualOdometry, before: VisualOdometry) -> bool:
    """Whether so few ties moved outward in the last step that an image may show another place."""
    s = now.settings
    usual = max(s.order_ratio * s.smallest_ties, before.last.outward / s.order_ratio)
    return now.last.outward < usual


def _from_here(
    view: View,
    images: Iterator[Detections],
    coming: deque[Detections],
    misplaced: set[int],
    odometry: VisualOdometry,
) -> Iterator[View]:
    """An image and those after it that will be used; these come again."""
    yield view
    for seen in count():
        if seen == len(coming):
            coming.extend(islice(images, 1))
        if seen == len(coming):
            return
        item = coming[seen]
        image = KeypointImage.of(item) if item.frame.used else None
        if image is None or item.frame.index in misplaced:
            continue
        if not shows_no_motion(view.image, image, odometry.settings, odometry.ties):
            view = View(item.frame, image)
            yield view


def _left_out(item: Detections, status: str) -> Detections:
    """An image that takes no part, without pixels and candidates; the number of its regions stays.

    So none is lost uncounted. Recorded bytes go as well: where a vehicle stands, any number of duplicates waits behind
    the tracking window.
    """
    frame = replace(item.frame, status=status, data=b"")
    segmentation = replace(
        item.segmentation,
        image=Image(frame, None, None),
        regions=Regions.empty(),
        dropped=NOTHING_DROPPED,
    )
    return Detections(segmentation, Candidates.of(Regions.empty()))
