"""What images under way may take: queues give way to the tracking window, and nothing else changes."""

from collections import deque
from dataclasses import replace
from threading import Lock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayside.pipeline.image_memory import ImageBuffers, ImageMemory
from wayside.pipeline.workers import Workers
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import DUPLICATE, USED, Frame

TRACKED_MB = 640 * 480 * 3 / 1e6
ONE_MB = 640 * 480 * (4 + 15 / 16) / 1e6 + 1e-3


def frames(statuses):
    """Images of 640 x 480 with a kilobyte recorded."""
    data = bytes(1000)
    return [Frame(k, k, None, s, "jpeg", data, None, 640, 480) for k, s in enumerate(statuses)]


def flow(items, memory, workers, queue, window):
    """The way of a frame as `Flow` has it, through workers and a window of used frames; order and most MB under way.

    Counted after the memory takes a frame, and before it lets one go: never more than the memory knows of.
    """
    under_way, lock = {"now": 0.0, "most": 0.0}, Lock()

    def counted(source, each_mb):
        for one in source:
            with lock:
                under_way["now"] += each_mb * one.used
                under_way["most"] = max(under_way["most"], under_way["now"])
            yield one

    def tracked(source):
        held = deque()
        for one in source:
            held.append(one)
            if sum(f.used for f in held) >= window:
                while held:
                    yield held.popleft()
        yield from held

    with Workers(workers) as pool:
        frames = counted(memory.taken(iter(items)), ONE_MB)
        has_room = {"has_room": lambda: memory.has_room}
        found = pool.ordered(lambda source: map(replace, source), frames, queue=queue, **has_room)
        used = memory.released(counted(found, TRACKED_MB - ONE_MB), lambda one: not one.used)
        gone = counted(tracked(used), -TRACKED_MB)
        order = [one.index for one in memory.released(gone, lambda one: True)]
    return order, under_way["most"]


@settings(max_examples=40, deadline=None)
@given(
    statuses=st.lists(st.sampled_from([USED, USED, DUPLICATE]), max_size=60),
    workers=st.integers(1, 4),
    queue=st.integers(1, 6),
    window=st.integers(1, 6),
    more=st.integers(0, 8),
)
def test_images_under_way_stay_within_the_limit_and_all_come(
    statuses, workers, queue, window, more
):
    limit = TRACKED_MB * window + ONE_MB * (1 + more) + 1e-6
    memory = ImageMemory(limit, window)
    order, most = flow(frames(statuses), memory, workers, queue, window)
    assert order == list(range(len(statuses)))
    assert most <= limit
    assert most * 1e6 - 100 <= memory.peak_bytes <= limit * 1e6
    assert workers > 1 or memory.peak_bytes == pytest.approx(most * 1e6, abs=100)


def test_without_a_limit_queues_are_full():
    _, most = flow(frames([USED] * 50), ImageMemory(0, 3), 4, 5, 3)
    assert most >= 4 * 5 * TRACKED_MB


def test_less_than_the_window_needs_is_refused_with_what_it_needs():
    memory = ImageMemory(9 * TRACKED_MB, 9)
    with pytest.raises(UsageError, match=r"10 images of 640 x 480 at once, which is 10 MB.*8 MB"):
        flow(frames([USED] * 3), memory, 2, 2, 9)


def test_memory_of_an_image_is_used_again_once_no_part_of_it_is_held():
    empty = ImageBuffers().empty
    part = empty((4, 6, 3))[1:3, :, 0]
    place, part[:] = part.ctypes.data, 5
    empty((4, 6, 3))[:] = 7
    assert (part == 5).all()
    del part
    assert empty((4, 6, 3))[1:3, :, 0].ctypes.data == place
