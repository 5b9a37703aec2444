"""Workers: order, bounds, clean ends."""

import threading
import time
from dataclasses import dataclass

import pytest

from wayside.pipeline.workers import StageClock, ordered_parallel
from wayside.schemas.errors import StageError


@dataclass(frozen=True)
class Numbered:
    """What travels, as far as the clock knows it: its frame has an index."""

    index: int

    @property
    def frame(self):
        return self


def uneven(items):
    for item in items:
        time.sleep(0.002 if item % 3 == 0 else 0)
        yield item * item


def own_threads():
    return [t for t in threading.enumerate() if t.name.startswith("wayside-")]


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
def test_results_come_in_the_order_of_the_items_whatever_the_number_of_workers(workers):
    results = list(ordered_parallel(uneven, iter(range(50)), workers=workers, queue=2))
    assert results == [n * n for n in range(50)]
    assert not own_threads()


def test_a_slow_consumer_makes_the_reader_wait():
    read = []

    def source():
        for n in range(100):
            read.append(n)
            yield n

    results = ordered_parallel(uneven, source(), workers=2, queue=3)
    for _ in range(5):
        next(results)
    assert len(read) <= 5 + 2 * 3
    results.close()
    assert not own_threads()


@pytest.mark.parametrize("way", ["exits", "returns"])
def test_a_worker_that_ends_is_a_fault_and_not_the_end_of_the_run(way):
    def ends_at_seven(items):
        for item in items:
            if item == 7 and way == "exits":
                raise SystemExit
            if item == 7:
                return
            yield item

    found = []
    with pytest.raises(StageError, match="stage workers failed"):
        found.extend(ordered_parallel(ends_at_seven, iter(range(50)), workers=2, queue=2))
    assert not own_threads()


def test_an_error_in_a_worker_is_raised_after_the_results_before_it_and_leaves_no_thread():
    def fails_at_seven(items):
        for item in items:
            if item == 7:
                raise ValueError("seven")
            yield item

    seen = []
    with pytest.raises(ValueError, match="seven"):
        seen.extend(ordered_parallel(fails_at_seven, iter(range(20)), workers=2, queue=2))
    assert seen == list(range(7))
    assert not own_threads()


def test_a_fault_names_the_stage_and_the_frame():
    def stage(items):
        for item in items:
            yield Numbered(1 // (item.index - 3))

    clock = StageClock()
    numbered = clock.timed("count", map(Numbered, range(9)))
    with pytest.raises(
        StageError, match="stage divide failed at frame 3: ZeroDivisionError"
    ) as caught:
        list(clock.timed("divide", stage(numbered)))
    assert (caught.value.stage, caught.value.frame) == ("divide", 3)


def test_a_fault_after_the_last_frame_names_the_stage_alone():
    clock = StageClock()
    list(clock.timed("count", map(Numbered, range(3))))
    with pytest.raises(StageError, match="stage sum failed: ZeroDivisionError"):
        list(clock.timed_drive("sum", (1 // n for n in (1, 0))))
    assert set(clock.seconds()) == {"count", "sum"}


def test_the_clock_counts_a_stage_without_the_stages_before_it():
    def busy(items):
        for item in items:
            end = time.thread_time() + 0.02
            while time.thread_time() < end:
                pass
            yield item

    clock = StageClock()
    first = clock.timed("first", busy(map(Numbered, range(1, 4))))
    list(clock.timed("second", (item for item in first)))
    seconds = clock.seconds()
    assert seconds["first"] > 10 * seconds["second"]


def test_what_is_done_between_two_stages_counts_for_neither():
    def busy(seconds):
        end = time.thread_time() + seconds
        while time.thread_time() < end:
            pass

    def watched(items):
        for item in items:
            with clock.aside("view"):
                busy(0.05)
            yield item

    clock = StageClock()
    first = watched(clock.timed("first", map(Numbered, range(1, 4))))
    list(clock.timed("second", (item for item in first)))
    seconds = clock.seconds()
    assert seconds["view"] >= 0.15
    assert max(seconds["first"], seconds["second"]) < seconds["view"] / 10
