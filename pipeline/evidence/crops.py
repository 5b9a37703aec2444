"""Images of a log again, only those that show a sign, and what is cut from them."""

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.files.pictures import blurred, webp_address
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.results.result import find_log, read_run, read_settings, read_times
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Frame, Image
from wayside.schemas.labels import Box
from wayside.stages.imaging import decode

Key = TypeVar("Key")
CONTEXT = 3.0
"""A crop is this many times as large as the box in it."""
SMALLEST_PX = 64
"""No crop is lower than this: of a face far away, its surroundings say what it is."""
_OUTSIDE_GREY = 200
PAPER, ACCENT = (255, 255, 255), (214, 0, 128)
"""Colours of the line around a box, outside and inside; no sign has the second."""
_THIN_TO_PX, _HALO_PX, _SHIFT = 280, 3, 4


@dataclass(frozen=True, slots=True)
class Crop:
    """A cut-out `rgb` (height, width, 3) uint8 with the `box` in edges of its pixels, (0, 0) its upper left corner."""

    rgb: NDArray[np.uint8]
    box: tuple[float, float, float, float]

    def scaled_to(self, width: int, height: int) -> "Crop":
        """The same, enlarged or shrunk to a size of (nearly) the same proportions."""
        along, down = width / self.rgb.shape[1], height / self.rgb.shape[0]
        method = cv2.INTER_CUBIC if along > 1 else cv2.INTER_AREA
        rgb = np.asarray(cv2.resize(self.rgb, (width, height), interpolation=method), np.uint8)
        x0, y0, x1, y1 = self.box
        return Crop(rgb, (x0 * along, y0 * down, x1 * along, y1 * down))


def cut(rgb: NDArray[np.uint8], box: Box, proportion: float) -> Crop:
    """Cut a box with its surroundings out of an image.

    `box`: x0, y0, x1, y1, half open, pixels. `proportion`: width over height of the crop, to the next pixel. The box
    stands in the middle, except near the edge of the image; a crop larger than the image is grey around it.
    """
    x0, y0, x1, y1 = box
    height = max(CONTEXT * (y1 - y0), CONTEXT * (x1 - x0) / proportion, SMALLEST_PX)
    tall, wide = math.ceil(height), math.ceil(height * proportion)
    left = _shifted_inside(round((x0 + x1 - wide) / 2), wide, rgb.shape[1])
    top = _shifted_inside(round((y0 + y1 - tall) / 2), tall, rgb.shape[0])
    crop = np.full((tall, wide, 3), _OUTSIDE_GREY, np.uint8)
    inside = rgb[max(top, 0) : max(top + tall, 0), max(left, 0) : max(left + wide, 0)]
    down, right = max(-top, 0), max(-left, 0)
    crop[down : down + inside.shape[0], right : right + inside.shape[1]] = inside
    return Crop(crop, (x0 - left, y0 - top, x1 - left, y1 - top))


def _shifted_inside(start: int, length: int, room: int) -> int:
    """Where a stretch must start to lie in 0 to `room`; unchanged where it is too long."""
    return start if length > room else min(max(start, 0), room - length)


def draw_crop(crop: Crop, size: tuple[int, int]) -> NDArray[np.uint8]:
    """A crop with its box, (height, width, 3) uint8 RGB; `size` is width, height of its proportion."""
    scaled = crop.scaled_to(*size)
    rgb = scaled.rgb.copy()
    thickness = 2 if size[0] <= _THIN_TO_PX else 3
    x0, y0, x1, y1 = (edge - 0.5 for edge in scaled.box)  # pixel centres stand at integers
    gap = (thickness + _HALO_PX) / 2 + 1  # the line goes around the face, not over it
    x0, y0, x1, y1 = x0 - gap, y0 - gap, x1 + gap, y1 + gap
    corners = np.array([[(x0, y0)], [(x1, y0)], [(x1, y1)], [(x0, y1)]]) * (1 << _SHIFT)
    outline = [np.rint(corners).astype(np.int32)]
    for ink, width in ((PAPER, thickness + _HALO_PX), (ACCENT, thickness)):
        cv2.polylines(rgb, outline, True, ink, width, cv2.LINE_AA, _SHIFT)
    return rgb


def read_crops(
    out: Path,
    log: Path | None,
    boxes: Iterable[tuple[Key, int, Box]],
    proportion: float,
    *,
    blur: bool = False,
) -> Iterator[tuple[Key, Crop | None]]:
    """Cut boxes with their surroundings out of the images of `read_boxes`; None where an image does not decode."""
    for key, image, box in read_boxes(out, log, boxes, blur=blur):
        yield key, None if image.rgb is None else cut(image.rgb, box, proportion)


def crop_addresses(
    out: Path, log: Path | None, boxes: Iterable[tuple[Key, int, Box]], size: tuple[int, int]
) -> tuple[dict[Key, str], str]:
    """Addresses of WebP images of boxes, those that the log gives; and why it gives no more, or an empty text."""
    images: dict[Key, str] = {}
    try:
        for key, crop in read_crops(out, log, boxes, size[0] / size[1]):
            if crop is not None:
                images[key] = webp_address(draw_crop(crop, size))
    except InputError as error:
        return images, str(error)
    return images, ""


def read_boxes(
    out: Path, log: Path | None, boxes: Iterable[tuple[Key, int, Box]], *, blur: bool = False
) -> Iterator[tuple[Key, Image, Box]]:
    """Boxes with their images from a result's log, which is read once.

    `log`: where it lies now, None: as at the time of the run. `boxes`: what to call a box, its frame and itself. They
    come in order of their frames; what the log has no longer does not come. What lies off the box is blurred with
    `blur`, or where the run was asked to (`read.blur`). Raises InputError where the result or the log cannot be used,
    or the log is another one.
    """
    wanted: defaultdict[int, list[tuple[Key, Box]]] = defaultdict(list)
    for key, frame, box in boxes:
        wanted[frame].append((key, box))
    if not wanted:
        return
    blur = blur or read_settings(out, read_run(out)).blur
    for image in read_images(out, log, wanted.keys()):
        for key, box in wanted[image.frame.index]:
            rgb = image.rgb
            if rgb is not None and blur:
                rgb = blurred(rgb, [box])
            yield key, replace(image, rgb=rgb), box


def read_images(out: Path, log: Path | None, wanted: Collection[int]) -> Iterator[Image]:
    """Decoded images of a result's log, of frames of these indices, in order; reading ends with the last of them.

    `log`: as of `read_boxes`. Raises InputError as that.
    """
    run, times_ns = read_run(out), read_times(out)
    source, settings = find_log(run, log), read_settings(out, run)

    def frames() -> Iterator[Frame]:
        last = max(wanted, default=-1)
        for frame in read_frames(source, settings, ReadReport()):
            if frame.index in wanted:
                if frame.log_time_ns != times_ns[frame.index]:
                    raise InputError(
                        f"{source}: this is not the log that the result was made from. Frame {frame.index} is of "
                        f"{frame.log_time_ns} ns instead of {times_ns[frame.index]} ns. Give the right one with "
                        "--log."
                    )
                yield frame
            if frame.index >= last:
                return

    return decode(frames())
