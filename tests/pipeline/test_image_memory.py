"""What images under way may take: queues give way to the tracking window, and nothing else changes."""

from collections import deque
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayside.pipeline.running.image_memory import ImageMemory
from wayside.pipeline.workers import Workers
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import DUPLICATE, USED, Frame

TRACKED_MB = 640 * 480 * 3 / 1e6
ONE_MB = 640 * 480 * (4 + 15 / 16) / 1e6 + 1e-3


def frames(statuses):
    """Images of 640 x 480 with a kilobyte recorded."""
    return [
        Frame(k, k, None, status, "jpeg", bytes(1000), None, 640, 480)
        for k, status in enumerate(statuses)
    ]


def flow(items, memory, workers, queue, window):
    """The way of a frame as `Flow` has it, through workers and a window of used frames; order and most MB under way."""
    order, under_way = [], {"now": 0.0, "most": 0.0}

    def counted(source):
        for one in source:
            under_way["now"] += ONE_MB * one.used
            under_way["most"] = max(under_way["most"], under_way["now"])
            yield one

    def tracked(source):
        held = deque()
        for one in source:
            under_way["now"] -= (ONE_MB - TRACKED_MB) * one.used
            held.append(one)
            if sum(f.used for f in held) >= window:
                while held:
                    yield held.popleft()
        yield from held

    def copied(source):
        return (replace(one) for one in source)

    with Workers(workers) as pool:
        frames = counted(memory.taken(iter(items)))
        found = pool.ordered(copied, frames, queue=queue, has_room=lambda: memory.has_room)
        used = memory.released(found, lambda one: not one.used)
        for one in memory.released(tracked(used), lambda one: True):
            under_way["now"] -= TRACKED_MB * one.used
            order.append(one.index)
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
    assert memory.peak_bytes == pytest.approx(most * 1e6, abs=100)


def test_without_a_limit_queues_are_full():
    memory = ImageMemory(0, 3)
    _, most = flow(frames([USED] * 50), memory, 4, 5, 3)
    assert most >= 4 * 5 * TRACKED_MB


def test_less_than_the_window_needs_is_refused_with_what_it_needs():
    memory = ImageMemory(9 * TRACKED_MB, 9)
    with pytest.raises(UsageError, match=r"10 images of 640 x 480 at once, which is 10 MB.*8 MB"):
        flow(frames([USED] * 3), memory, 2, 2, 9)
