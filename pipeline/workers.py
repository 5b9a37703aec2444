"""Workers and bounded queues around a chain of stages that knows nothing of them."""

from __future__ import annotations

import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from queue import Queue
from time import thread_time
from typing import Any, TypeVar

from wayside.schemas.errors import StageError, WaysideError

Item = TypeVar("Item")
Result = TypeVar("Result")


class StageClock:
    """CPU seconds of each stage, summed over the workers."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seconds: dict[str, float] = defaultdict(float)

    def add(self, stage: str, seconds: float) -> None:
        """Count time spent in a stage."""
        with self._lock:
            self._seconds[stage] += seconds

    def seconds(self) -> dict[str, float]:
        """CPU seconds by stage so far."""
        with self._lock:
            return dict(self._seconds)


def staged(
    name: str,
    stage: Callable[[Iterator[Item]], Iterator[Result]],
    items: Iterator[Item],
    clock: StageClock,
    frame_of: Callable[[Item], int | None],
) -> Iterator[Result]:
    """Run one stage, timed, so that a fault in it names the stage and the frame it worked on.

    Raises
    ------
    StageError
        Where the stage raised anything that is not already a `WaysideError`.
    """
    frame: int | None = None
    upstream = 0.0

    def watched() -> Iterator[Item]:
        nonlocal frame, upstream
        while True:
            start = thread_time()
            item = next(items, None)
            upstream += thread_time() - start
            if item is None:
                return
            frame = frame_of(item)
            yield item

    results = stage(watched())
    while True:
        start, upstream = thread_time(), 0.0
        try:
            result = next(results, None)
        except WaysideError:
            raise
        except Exception as fault:
            raise StageError(name, frame, fault) from fault
        clock.add(name, thread_time() - start - upstream)
        if result is None:
            return
        yield result


@dataclass(frozen=True, slots=True)
class _Fault:
    error: BaseException


_END: Any = object()


def ordered_parallel(
    chain: Callable[[Iterator[Item]], Iterator[Result]],
    items: Iterator[Item],
    *,
    workers: int,
    queue: int,
) -> Iterator[Result]:
    """Send items through `chain` in several threads; results come in the order of the items.

    Every worker has its own instance of the chain and its own pair of queues; items are dealt in turn, so the result
    does not depend on who is faster. At most `workers * queue` items are under way: a slow consumer makes the
    reader wait. The chain must give one result an item, in order. One worker means no thread at all.

    A fault in a worker is raised here, after the results before it; leaving the generator early (an error
    downstream, an interrupt) stops and joins all workers.
    """
    if workers == 1:
        yield from chain(items)
        return

    incoming: list[Queue[Any]] = [Queue(queue + 1) for _ in range(workers)]
    outgoing: list[Queue[Any]] = [Queue(queue + 1) for _ in range(workers)]
    stop = threading.Event()

    def work(mine: Queue[Any], done: Queue[Any]) -> None:
        def dealt() -> Iterator[Item]:
            while (item := mine.get()) is not _END and not stop.is_set():
                yield item

        try:
            for result in chain(dealt()):
                done.put(result)
        except BaseException as error:
            done.put(_Fault(error))

    threads = [
        threading.Thread(target=work, args=pair, name=f"wayside-{n}", daemon=True)
        for n, pair in enumerate(zip(incoming, outgoing, strict=True))
    ]
    for thread in threads:
        thread.start()
    under_way: deque[int] = deque()
    dealt_count = 0
    try:
        more = True
        while True:
            while more and len(under_way) < workers * queue:
                item = next(items, _END)
                if item is _END:
                    more = False
                    break
                turn = dealt_count % workers
                incoming[turn].put(item)
                under_way.append(turn)
                dealt_count += 1
            if not under_way:
                return
            result = outgoing[under_way.popleft()].get()
            if isinstance(result, _Fault):
                raise result.error
            yield result
    finally:
        stop.set()
        for mine in incoming:
            mine.put(_END)
        for thread in threads:
            thread.join()
