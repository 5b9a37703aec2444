"""What becomes of each image of a log, in order: used, or the reason why not."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.pipeline.reading.contents import ImageContent
from wayside.pipeline.reading.copies import ImageNumbers
from wayside.pipeline.reading.exif import read_exif
from wayside.pipeline.reading.image_headers import format_and_size
from wayside.pipeline.reading.plan import Plan
from wayside.pipeline.reading.thinning import Thinning, position_of
from wayside.schemas.frame import (
    DUPLICATE,
    NO_CALIBRATION,
    NO_POSITION,
    OTHER_CAMERA,
    OUTSIDE,
    SKIPPED,
    THINNED,
    TURNED,
    UNDECODABLE,
    USED,
    WRONG_SIZE,
    Camera,
    Fix,
    Frame,
    PosePrior,
)
from wayside.schemas.settings import ReadSettings

_NOTHING = memoryview(b"")
_SILENCE_NS = 5_000_000_000
"""Without pose, fix or spacing the speed before is carried on to the next image, but not across a longer silence."""


@dataclass(frozen=True, slots=True)
class PlacedImage:
    """An image message in its place; `image` is None where it could not be decoded.

    time_ns: when it was taken; settled_ns: as in `Frame`; fault: status of an image that is not to be used, known
    before anything else of it is looked at.
    """

    index: int
    number: int
    log_time_ns: int
    time_ns: int
    settled_ns: int | None
    image: ImageContent | None
    fault: str = ""


class Selection:
    """Decides what becomes of each image, in order."""

    def __init__(self, plan: Plan, settings: ReadSettings) -> None:
        self.settings = settings
        self.spacing_m = plan.spacing_m
        self.thinning = Thinning(settings.thin_m, plan.spacing_m)
        self.numbers = ImageNumbers()
        self.names, self.dates = plan.survey.image_names, plan.survey.image_dates
        self.first_ns: int | None = None
        self.inside = 0
        self.last_used: int | None = None
        self.used_ns = 0
        self.last_camera: Camera | None = None

    def decide(
        self, one: PlacedImage, camera: Camera | None, pose: PosePrior | None, fix: Fix | None
    ) -> Frame:
        """The frame of an image, with its status."""
        if self.first_ns is None:
            self.first_ns = one.time_ns
        self.last_camera = camera
        image = one.image
        encoding, width, height = "", 0, 0
        if image is not None:
            encoding, width, height = format_and_size(image)
        status, number = OUTSIDE, one.number
        name = self.names.get(str(one.log_time_ns), "")
        if self._is_inside(one.time_ns) and one.fault == OTHER_CAMERA:
            status = OTHER_CAMERA
        elif self._is_inside(one.time_ns):
            data = _NOTHING if image is None else image.data
            number, is_copy = self.numbers.take(number, name or f"frame {one.index}", data)
            known = (width, height), camera, pose, fix, one.time_ns
            status = DUPLICATE if is_copy else self._status(image, one.fault, number, *known)
        used = status == USED and image is not None
        spacing_m = None
        if used:
            if self.spacing_m and self.last_used is not None:
                spacing_m = self.spacing_m * (number - self.last_used)
            self.last_used, self.used_ns = number, one.time_ns
        return Frame(
            index=one.index,
            log_time_ns=one.log_time_ns,
            header_time_ns=None if image is None else image.time_ns,
            status=status,
            encoding=encoding,
            data=image.data if used and image is not None else _NOTHING,
            camera=camera,
            width=width,
            height=height,
            step=0 if image is None else image.step,
            pose=pose,
            fix=fix,
            spacing_m=spacing_m,
            settled_time_ns=one.settled_ns,
            name=name,
            date=self.dates.get(str(one.log_time_ns), ""),
        )

    def _is_inside(self, time_ns: int) -> bool:
        """Whether a time lies in the part asked for."""
        settings = self.settings
        passed_s = (time_ns - (self.first_ns or 0)) / 1e9
        return passed_s >= settings.from_s and not 0 < settings.until_s < passed_s

    def _status(
        self,
        image: ImageContent | None,
        fault: str,
        number: int,
        size: tuple[int, int],
        camera: Camera | None,
        pose: PosePrior | None,
        fix: Fix | None,
        time_ns: int,
    ) -> str:
        self.inside += 1
        if (self.inside - 1) % self.settings.every:
            return SKIPPED
        if fault:
            return fault
        if image is None:
            return UNDECODABLE
        if camera is None:
            return NO_CALIBRATION
        if size != (0, 0) and size != (camera.width, camera.height):
            return WRONG_SIZE
        if not image.width and read_exif(image.data).turned:
            return TURNED
        placed = pose is not None or fix is not None or self.spacing_m > 0
        if not placed and (self.last_used is None or time_ns - self.used_ns > _SILENCE_NS):
            return NO_POSITION
        return USED if self.thinning.keeps(number, position_of(pose, fix), time_ns) else THINNED
