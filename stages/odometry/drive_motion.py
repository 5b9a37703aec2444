"""The motion stage: which images of a drive take part, and the camera's motion between them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

from wayside.schemas.detections import NOTHING_DROPPED, Candidates, Detections, Regions
from wayside.schemas.frame import DUPLICATE, OTHER_PLACE, Frame, Image
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import AdjustmentSettings, MotionSettings, TieSettings
from wayside.stages.odometry.image_order import REACH, ImageOrder, View
from wayside.stages.odometry.standing import shows_no_motion
from wayside.stages.odometry.tie_points import KeypointImage
from wayside.stages.odometry.visual_odometry import OdometryStep, VisualOdometry

HELD_IMAGES = 1 + REACH
"""Images that wait here at most while one more comes: around a doubtful step."""


class StepMemory(Protocol):
    """Keeps the steps of a run for one that goes on with it."""

    def recall(self, frame: int) -> OdometryStep | None:
        """The step to a frame in the run before; None where it did not come so far."""

    def keep(self, frame: int, step: OdometryStep) -> None:
        """Take a new step, in the order of the frames."""


def estimate_motion(
    images: Iterator[Detections],
    settings: MotionSettings,
    ties: TieSettings,
    adjustment: AdjustmentSettings,
    memory: StepMemory | None = None,
) -> Iterator[PosedDetections]:
    """Add the camera's motion to each image.

    Frames that are not used pass with motion None. The first used frame is the origin of the drive's own frame.
    Steps that `memory` recalls are not measured again.
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
    stage = _MotionStage(VisualOdometry(settings, ties, adjustment), images, memory)
    while (item := stage.next_image()) is not None:
        yield from stage.take(item)
    yield from stage.release()


class _MotionStage:
    """The odometry, and the images that may still be left out.

    earlier, earlier_gap_m: state before the newest used image, None where that has left; past: used images, the newest
    last; gap_m: spacing of images left out since; held: the newest used image and what has come since; recalled: frames
    whose steps are in the memory; misplaced: frames known to show other places.
    """

    def __init__(
        self,
        odometry: VisualOdometry,
        images: Iterator[Detections],
        memory: StepMemory | None,
    ) -> None:
        self.odometry, self.images, self.memory = odometry, images, memory
        self.earlier: VisualOdometry | None = None
        self.gap_m = self.earlier_gap_m = 0.0
        self.past: list[View] = []
        self.coming: deque[Detections] = deque()
        self.held: list[tuple[Detections, OdometryStep | None]] = []
        self.recalled: set[int] = set()
        self.misplaced: set[int] = set()

    def next_image(self) -> Detections | None:
        """The next image, None at the end."""
        return self.coming.popleft() if self.coming else next(self.images, None)

    def take(self, item: Detections) -> Iterator[PosedDetections]:
        """Take in an image; those that are certain now."""
        frame = item.frame
        if not frame.used:
            yield from self._hold(item, None)
            return
        step = None if self.memory is None else self.memory.recall(frame.index)
        if step is not None:
            self.recalled.add(frame.index)
            self.misplaced |= set(step.misplaced)
        elif frame.index in self.misplaced:
            step = self._other_place(frame)
        if step is not None and step.motion is None:
            self._skip(frame, step)
            yield from self._hold(item, step)
            return
        image = KeypointImage.of(item)
        s, ties = self.odometry.settings, self.odometry.ties
        if step is None and shows_no_motion(self.odometry.image, image, s, ties):
            yield from self._hold(item, OdometryStep(None, status=DUPLICATE))
            return
        before = self.odometry.copy()
        if step is not None:
            self.odometry.take(step, image, frame)
        else:
            spacing_m = None if frame.spacing_m is None else frame.spacing_m + self.gap_m
            self.odometry.advance(image, replace(frame, spacing_m=spacing_m))
            if image is not None and (found := self._misplaced(before, View(frame, image))):
                yield from self._leave_out(found, before, item)
                return
        yield from self.release()
        self.earlier, self.earlier_gap_m, self.gap_m = before, self.gap_m, 0.0
        self.past = [*self.past[-REACH:], View(frame, image)] if image is not None else []
        self.held = [(item, self.odometry.last)]

    def release(self) -> Iterator[PosedDetections]:
        """Let go of what waits: it is certain."""
        for item, step in self.held:
            index = item.frame.index
            if self.memory is not None and step is not None and index not in self.recalled:
                self.memory.keep(index, step)
            out = item if step is None or step.motion is not None else _left_out(item, step.status)
            yield PosedDetections(out, None if step is None else step.motion)
        self.held, self.earlier = [], None

    def _hold(self, item: Detections, step: OdometryStep | None) -> Iterator[PosedDetections]:
        self.held.append((item, step))
        if self.earlier is None:
            yield from self.release()

    def _other_place(self, frame: Frame) -> OdometryStep:
        later = tuple(sorted(i for i in self.misplaced if i > frame.index))
        return OdometryStep(None, status=OTHER_PLACE, misplaced=later)

    def _skip(self, frame: Frame, step: OdometryStep) -> None:
        if step.status == OTHER_PLACE:
            self.gap_m += frame.spacing_m or 0.0

    def _misplaced(self, before: VisualOdometry, view: View) -> set[int]:
        """Frames that show another place, by the step to an image that has been made; mostly none."""
        s, step = self.odometry.settings, self.odometry.last
        usual = max(s.order_ratio * s.smallest_ties, before.last.outward / s.order_ratio)
        if not self.past or step.outward >= usual:
            return set()
        order = ImageOrder(
            s, before.ties, before.estimate, before.mount.travel, before.last.rotation
        )
        views = [view, *self._look_ahead(view)]
        sure = len(self.past) - (self.earlier is not None)
        return order.misplaced(self.past, views, sure=sure)

    def _look_ahead(self, view: View) -> list[View]:
        """The next images that will be used, as far as they are compared; they come again."""
        found: list[View] = []
        seen = 0
        while len(found) < REACH:
            if seen == len(self.coming):
                if (item := next(self.images, None)) is None:
                    break
                self.coming.append(item)
            item, seen = self.coming[seen], seen + 1
            image = KeypointImage.of(item) if item.frame.used else None
            if image is None or item.frame.index in self.misplaced:
                continue
            last = found[-1] if found else view
            if not shows_no_motion(last.image, image, self.odometry.settings, self.odometry.ties):
                found.append(View(item.frame, image))
        return found

    def _leave_out(
        self, found: set[int], before: VisualOdometry, item: Detections
    ) -> Iterator[PosedDetections]:
        """Go back before the first image that is left out; `item` comes again."""
        self.misplaced |= found
        self.coming.appendleft(item)
        self.odometry = before
        newest = self.past[-1].frame
        if newest.index not in found:
            return
        assert self.earlier is not None
        self.odometry, self.gap_m = self.earlier, self.earlier_gap_m
        step = self._other_place(newest)
        self._skip(newest, step)
        self.past.pop()
        self.held[0] = self.held[0][0], step
        yield from self.release()


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
