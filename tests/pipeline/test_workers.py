"""Workers: order, bounds, clean ends."""

import threading
import time
from dataclasses import dataclass

import pytest

from wayside.pipeline import workers
from wayside.pipeline.workers import StageClock, Workers
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
    with Workers(workers) as pool:
        results = list(pool.ordered(uneven, iter(range(50)), queue=2))
    assert results == [n * n for n in range(50)]
    assert not own_threads()


def test_a_slow_consumer_makes_the_reader_wait():
    read = []

    def source():
        for n in range(100):
            read.append(n)
            yield n

    with Workers(2) as pool:
        results = pool.ordered(uneven, source(), queue=3)
        for _ in range(5):
            next(results)
    assert len(read) <= 5 + 2 * 3
    assert not own_threads()


@pytest.mark.parametrize(
    ("end", "kind", "words"),
    [
        (ValueError("seven"), ValueError, "seven"),
        (SystemExit(), StageError, "stage workers failed"),
        (None, StageError, "stage workers failed"),
    ],
    ids=["raises", "exits", "returns"],
)
def test_a_worker_that_ends_is_a_fault_after_the_results_before_it(end, kind, words):
    def ends_at_seven(items):
        for item in items:
            if item == 7 and end is not None:
                raise end
            if item == 7:
                return
            yield item

    found = []
    with pytest.raises(kind, match=words), Workers(2) as pool:
        found.extend(pool.ordered(ends_at_seven, iter(range(50)), queue=2))
    assert found == list(range(7))
    assert not own_threads()


def test_a_fault_names_the_stage_and_the_frame_if_it_was_at_one():
    clock = StageClock()
    numbered = clock.timed("count", map(Numbered, range(9)))
    divided = (Numbered(1 // (item.index - 3)) for item in numbered)
    words = "stage divide failed at frame 3: ZeroDivisionError"
    with pytest.raises(StageError, match=words) as caught:
        list(clock.timed("divide", divided))
    assert (caught.value.stage, caught.value.frame) == ("divide", 3)
    with pytest.raises(StageError, match="stage sum failed: ZeroDivisionError"):
        list(clock.timed_drive("sum", (1 // n for n in (1, 0))))
    assert set(clock.seconds()) == {"count", "divide", "sum"}


def test_the_clock_counts_work_apart_in_whichever_thread_it_is_done(monkeypatch):
    clock, seconds = StageClock(), threading.local()
    monkeypatch.setattr(workers, "thread_time", lambda: getattr(seconds, "now", 0.0))

    def costs(item):
        seconds.now = getattr(seconds, "now", 0.0) + 1.0
        return item

    def shares(items):
        for item in items:
            done = threading.Thread(target=clock.apart("measure", costs), args=(item,))
            done.start()
            done.join()
            yield clock.apart("measure", costs)(item)

    list(clock.timed("shares", shares(map(Numbered, range(3)))))
    assert clock.seconds() == pytest.approx({"measure": 6.0, "shares": 0.0})


def test_the_clock_counts_each_stage_alone_and_what_is_done_between_two_apart(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(workers, "thread_time", lambda: now[0])

    def busy(seconds, items):
        for item in items:
            now[0] += seconds
            yield item

    def watched(items):
        for item in items:
            clock.apart("view", next)(busy(8.0, [item]))
            yield item

    clock = StageClock()
    first = watched(clock.timed("first", busy(1.0, map(Numbered, range(3)))))
    list(clock.timed("second", busy(2.0, first)))
    assert clock.seconds() == pytest.approx({"first": 3.0, "second": 6.0, "view": 24.0})
