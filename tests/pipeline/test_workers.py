"""Workers: order, bounds, clean ends."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from wayside.pipeline import forked_workers, workers
from wayside.pipeline.forked_workers import ForkedWorkers
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


def threads(count):
    return Workers(count)


def forks(count):
    return ForkedWorkers(count, StageClock())


needs_forks = pytest.mark.skipif(not forked_workers.can_fork(), reason="no forks here")
KINDS = [threads, pytest.param(forks, marks=needs_forks)]


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_results_come_in_the_order_of_the_items_whatever_the_number_of_workers(kind, workers):
    with kind(workers) as pool:
        results = list(pool.ordered(uneven, iter(range(50)), queue=2))
    assert results == [n * n for n in range(50)]
    assert not own_threads()
    assert not multiprocessing.active_children()


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
@pytest.mark.parametrize("workers", KINDS)
def test_a_worker_that_ends_is_a_fault_after_the_results_before_it(workers, end, kind, words):
    def ends_at_seven(items):
        for item in items:
            if item == 7 and end is not None:
                raise end
            if item == 7:
                return
            yield item

    found = []
    with pytest.raises(kind, match=words), workers(2) as pool:
        found.extend(pool.ordered(ends_at_seven, iter(range(50)), queue=2))
    assert found == list(range(7))
    assert not own_threads()


def images(items):
    """Two large arrays and a small one of each item, and where they were made."""
    for item in items:
        large = np.full((400, 600, 3), item.index % 256, np.uint8)
        yield large, large[..., 0] + 1, np.arange(item.index), os.getpid()


@needs_forks
@pytest.mark.parametrize(
    ("room_bytes", "rooms"),
    [(1 << 26, [[0, 1, 2, 3], [4, 5, 6]]), (1 << 50, [])],
    ids=["shared", "refused by the system"],
)
def test_large_arrays_come_back_from_processes_and_their_memory_is_used_again(
    monkeypatch, room_bytes, rooms
):
    monkeypatch.setattr(forked_workers, "ROOMS", (4, 3))
    monkeypatch.setattr(forked_workers, "ROOM_BYTES", room_bytes)
    items, pool, held = map(Numbered, range(40)), forks(3), []
    with pool:
        for index, (*arrays, process) in enumerate(pool.ordered(images, items, queue=2)):
            held.append(process)
            wanted = next(images(iter([Numbered(index)])))
            for array, same in zip(arrays, wanted, strict=False):
                np.testing.assert_array_equal(array, same)
            if index < 12:  # more than there is room for
                held.append(arrays)
    assert len({one for one in held if isinstance(one, int)}) == 3
    del held, arrays, array
    assert [sorted(free) for free in pool._rooms.free] == rooms


@needs_forks
def test_a_process_that_dies_is_a_fault_that_names_the_frame():
    parent = os.getpid()

    def dies(items):
        for item in items:
            if os.getpid() != parent:
                os.kill(os.getpid(), signal.SIGKILL)
            yield item

    words = "stage workers failed at frame 1: RuntimeError: a worker process has ended"
    with pytest.raises(StageError, match=words), forks(2) as pool:
        list(pool.ordered(dies, map(Numbered, range(9)), queue=1))
    assert not multiprocessing.active_children()


@needs_forks
def test_processes_end_with_the_one_that_is_killed():
    program = """
import os, signal
from test_workers import Numbered, forks, images
pool = forks(3)
results = pool.ordered(images, map(Numbered, range(9)), queue=1)
next(results), next(results)
print(*(process.pid for process in pool._processes), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
    path = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=path, capture_output=True, text=True, timeout=60
    )
    late = time.monotonic() + 10
    for number in map(int, done.stdout.split()):
        while Path(f"/proc/{number}/stat").exists() and time.monotonic() < late:
            time.sleep(0.01)
    assert done.stdout
    assert time.monotonic() < late


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


@needs_forks
def test_the_clock_counts_what_processes_do():
    pool = forks(2)

    def busy(items):
        for item in items:
            pool._clock.add("found", 1.0)
            yield item

    with pool:
        list(pool.ordered(busy, map(Numbered, range(9)), queue=1))
    assert pool._clock.seconds()["found"] == 9


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
