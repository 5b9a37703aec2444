"""Memory of the images under way: those that wait in queues, are searched, or are held by the tracking window."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from math import prod
from mmap import mmap
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.workers import Result
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import Frame

_HELD_A_PIXEL, _FOUND_A_PIXEL = 3, 3 + 3 * (1 / 4 + 1 / 16) + 1
"""Bytes of colour, which tracking holds; before it there are smaller sizes and grey, too."""
_MEGABYTE = 1e6


@dataclass(slots=True)
class ImageMemory:
    """Counts images, by the sizes in the headers, from the moment they are read until nothing holds their pixels.

    Reading and tracking call it from two threads.
    """

    limit_mb: float = 0.0
    """What they may take; 0: as much as it comes to."""
    window: int = 0
    """Images that motion and tracking hold at most, which are needed whatever the limit is."""
    peak_bytes: int = 0
    """The most that they took."""
    _bytes: int = 0
    _largest: int = 0
    _held: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Bytes of each frame, and those that are left of them when it is tracked."""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def has_room(self) -> bool:
        """Whether one more image, as large as the largest so far, is within the limit."""
        return not self.limit_mb or self._bytes + self._largest <= self.limit_mb * _MEGABYTE

    def taken(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Pass frames on and count their images; raises UsageError where the limit is too small for the window."""
        for frame in frames:
            if frame.used:
                self._take(frame)
            yield frame

    def released(
        self, items: Iterator[Result], leaves: Callable[[Result], bool]
    ) -> Iterator[Result]:
        """Pass items on and count those out that leave: their pixels are held no longer. Others go on to be tracked."""
        for item in items:
            with self._lock:
                one, tracked = self._held.pop(item.frame.index, (0, 0))
                if leaves(item):
                    tracked = 0
                elif one:
                    self._held[item.frame.index] = tracked, tracked
                self._bytes -= one - tracked
            yield item

    def _take(self, frame: Frame) -> None:
        width, height = frame.width, frame.height
        if frame.camera is not None and not (width and height):
            width, height = frame.camera.width, frame.camera.height
        tracked = round(width * height * _HELD_A_PIXEL)
        one = round(width * height * _FOUND_A_PIXEL) + len(frame.data)
        needed = (self.window * tracked + one) / _MEGABYTE
        if 0 < self.limit_mb < needed:
            raise UsageError(
                f"--memory: motion and tracking hold {self.window + 1} images of {width} x {height} at once, which is "
                f"{needed:.0f} MB and more than {self.limit_mb:.0f} MB. Give more, or lower the setting "
                "track.longest."
            )
        with self._lock:
            self._held[frame.index] = one, tracked
            self._bytes += one
            self._largest = max(self._largest, one)
            self.peak_bytes = max(self.peak_bytes, self._bytes)


class ImageBuffers:
    """Memory of images that is used again; threads may share it.

    In the heap, images leave holes among small things that stay: 110 MB after 4,800 images.
    """

    def __init__(self) -> None:
        self._free = lru_cache(2)(lambda size: list[mmap]())  # of colour and of grey

    def empty(self, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """An array; its memory goes to another one when nothing holds it, or a part of it, any more."""
        free = self._free(prod(shape))
        try:
            memory = free.pop()
        except IndexError:
            memory = mmap(-1, prod(shape))
        array = np.frombuffer(memory, np.uint8)  # the base of all its parts
        finalize(array, free.append, memory)
        return array.reshape(shape)
