"""Status of each image of a log, in order: used, or the reason why not."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from zlib import crc32

from wayside.pipeline.reading.image_headers import read_exif
from wayside.pipeline.reading.plan import listed
from wayside.schemas.frame import (
    DUPLICATE,
    EARTH_RADIUS_M,
    NO_CALIBRATION,
    NO_POSITION,
    OTHER_CAMERA,
    OUTSIDE,
    SKIPPED,
    THINNED,
    TURNED,
    USED,
    WRONG_SIZE,
    Frame,
)
from wayside.schemas.settings import ReadSettings
from wayside.stages.geometry import turn_deg

_SILENCE_NS = 5_000_000_000
"""Without pose, fix or spacing the speed before is carried on to the next image, but not across a longer silence."""
_MOST_LISTED = 4
_STANDING_NS, _STANDING_SHARE = 1_000_000_000, 0.25
"""Where positions stand still, within this share of the distance, an image a second is used all the same: positions may
be wrong, and only images tell whether the camera moves."""

_Place = tuple[int, Frame]
"""An image and its number along the way."""


class Selection:
    """Decides the status of each image, in order.

    A copy agrees in every byte with an earlier image, which two exposures of a camera never do. It takes no number,
    because the vehicle did not move for it. A hash of 64 bits is kept of each image.

    An image is used where its distance from the last used one, plus half of the latest step, reaches `thin_m`: of two
    neighbours the one nearer to the wanted place. The distance is measured straight from the last used
    image and never summed up, so that jitter while standing still adds up to nothing.
    """

    def __init__(self, settings: ReadSettings, spacing_m: float) -> None:
        self.settings, self.spacing_m = settings, spacing_m
        self.first_ns: int | None = None
        self.inside = 0
        self.seen: set[tuple[int, int]] = set()
        self.taken_by_copies = 0
        self.numbered: tuple[int, str] | None = None
        self.gaps: list[tuple[int, str]] = []
        self.used: _Place | None = None
        self.latest: _Place | None = None

    def decide(self, frame: Frame, number: int) -> Frame:
        """The frame with its status and, where it is used, its spacing; without data elsewhere.

        `frame`: its status is `used`, or what is wrong with it already; `number`: counts the images taken.
        """
        if self.first_ns is None:
            self.first_ns = frame.time_ns
        passed_s = (frame.time_ns - self.first_ns) / 1e9
        last = self.used
        if passed_s < self.settings.from_s or 0 < self.settings.until_s < passed_s:
            status = OUTSIDE
        elif frame.status == OTHER_CAMERA:
            status = OTHER_CAMERA
        else:
            is_copy = self._is_copy(frame, number)
            number -= self.taken_by_copies
            status = DUPLICATE if is_copy else self._status(frame, number)
        if status != USED:
            return replace(frame, status=status, data=b"")
        if not self.spacing_m or last is None:
            return frame
        return replace(frame, spacing_m=self.spacing_m * (number - last[0]))

    def notes(self) -> Iterator[str]:
        """Which numbers are missing, in words."""
        if self.gaps:
            places = [f"{count} after {label}" for count, label in self.gaps]
            yield (
                f"missing numbers among the images: {sum(count for count, _ in self.gaps)} "
                f"({listed(places, _MOST_LISTED)}); each adds one spacing to the step across its gap"
            )

    def _is_copy(self, frame: Frame, number: int) -> bool:
        data, half = memoryview(frame.data), len(frame.data) // 2
        digest = crc32(data[:half]), crc32(data[half:])  # without the interpreter lock
        is_copy = len(frame.data) > 0 and digest in self.seen
        self.seen.add(digest)
        if self.numbered is not None:
            step = number - self.numbered[0]
            if step > 1:
                self.gaps.append((step - 1, self.numbered[1]))
            if is_copy:
                self.taken_by_copies += step
        self.numbered = number, frame.label
        return is_copy

    def _status(self, frame: Frame, number: int) -> str:
        self.inside += 1
        if (self.inside - 1) % self.settings.every:
            return SKIPPED
        if not frame.used:
            return frame.status
        camera, size = frame.camera, (frame.width, frame.height)
        if camera is None:
            return NO_CALIBRATION
        if size not in ((0, 0), (camera.width, camera.height)):
            return WRONG_SIZE
        if read_exif(frame.data).turned:
            return TURNED
        placed = frame.pose is not None or frame.fix is not None or self.spacing_m > 0
        if not placed and (self.used is None or frame.time_ns - self.used[1].time_ns > _SILENCE_NS):
            return NO_POSITION
        here = number, frame
        latest, self.latest = self.latest, (number, replace(frame, data=b""))
        if self.used is not None and latest is not None and self.settings.thin_m > 0:
            way, step = self._between(self.used, here), self._between(latest, here)
            is_near = way is not None and way + (step or 0.0) / 2 < self.settings.thin_m
            stands = way is not None and way < _STANDING_SHARE * self.settings.thin_m
            waited_ns = frame.time_ns - self.used[1].time_ns
            if is_near and not (stands and waited_ns >= _STANDING_NS):
                return THINNED
        self.used = self.latest
        return USED

    def _between(self, first: _Place, second: _Place) -> float | None:
        """Straight distance, metres: by poses, else by fixes, else by numbers; None where nothing tells it."""
        (number, a), (following, b) = first, second
        if a.pose is not None and b.pose is not None:
            return math.dist(a.pose.pose.centre.tolist(), b.pose.pose.centre.tolist())
        if a.fix is not None and b.fix is not None:
            # In the plane: the heights of fixes jitter most and tell nothing of the way along the road.
            latitude, turn = a.fix.latitude_deg, turn_deg(a.fix.longitude_deg, b.fix.longitude_deg)
            middle = math.radians((latitude + b.fix.latitude_deg) / 2)
            north = math.radians(b.fix.latitude_deg - latitude)
            return EARTH_RADIUS_M * math.hypot(math.radians(turn) * math.cos(middle), north)
        return self.spacing_m * (following - number) if self.spacing_m else None


def describe_duplicates(labels: Sequence[str]) -> str:
    """A note on images of the status `duplicate`, by their names or frames."""
    return (
        f"duplicate images: {len(labels)} ({listed(labels, _MOST_LISTED)}); they are copies of an earlier one "
        "or show no motion since the last used one, and add nothing to the distance travelled"
    )
