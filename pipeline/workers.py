"""Stages by name, the clock that counts their time, and workers around a chain of them that knows nothing of them."""

import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from time import thread_time
from typing import Concatenate, Generic, ParamSpec, Protocol, TypeVar

from wayside.schemas.errors import StageError, WaysideError
from wayside.schemas.frame import Frame


class Item(Protocol):
    """What travels through the flow: every type knows the frame it belongs to."""

    @property
    def frame(self) -> Frame:
        """The frame."""


Source = TypeVar("Source", bound=Item)
Result = TypeVar("Result", bound=Item)
Value = TypeVar("Value")
Given = TypeVar("Given")
Options = ParamSpec("Options")


@dataclass(frozen=True, slots=True)
class Stage(Generic[Given, Value]):
    """A step of a chain: a generator from one type to another, under the name that clock, viewer and errors use."""

    name: str
    run: Callable[[Iterator[Given]], Iterator[Value]]
    seen: bool = True
    """Whether the observer sees its items: not of a stage that passes them on as they are."""

    def unseen(self) -> "Stage[Given, Value]":
        """The same, of which the observer sees nothing."""
        return replace(self, seen=False)


def stage(
    name: str,
    function: Callable[Concatenate[Iterator[Given], Options], Iterator[Value]],
    *args: Options.args,
    **options: Options.kwargs,
) -> Stage[Given, Value]:
    """A stage of a function on an iterator and its options."""
    return Stage(name, lambda items: function(items, *args, **options))


class StageClock:
    """CPU seconds of each stage, summed over the workers.

    A stage is a chain of generators, so asking one for an item runs those before it, too. Its own time is the time of
    the call less the time of earlier stages in it.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seconds: dict[str, float] = defaultdict(float)
        self._thread = _ThreadState()

    def add(self, stage: str, seconds: float) -> None:
        """Count time spent in a stage."""
        with self._lock:
            self._seconds[stage] += seconds

    def apart(self, name: str, function: Callable[[Given], Value]) -> Callable[[Given], Value]:
        """The function, whose time counts under a name of its own in whichever thread or stage it runs."""

        def counted(item: Given) -> Value:
            start = thread_time()
            try:
                return function(item)
            finally:
                spent = thread_time() - start
                self.add(name, spent)
                self._thread.upstream += spent

        return counted

    def seconds(self) -> dict[str, float]:
        """CPU seconds by stage so far."""
        with self._lock:
            return dict(self._seconds)

    def timed(self, name: str, items: Iterator[Result]) -> Iterator[Result]:
        """The items of a stage, its time counted; a fault in it names the stage and the frame it worked on.

        Raises StageError where the stage raised anything that is not already a `WaysideError`.
        """
        for item in self._counted(name, items):
            self._thread.frame = item.frame.index
            yield item

    def timed_drive(self, name: str, items: Iterator[Value]) -> Iterator[Value]:
        """The same of a stage after the last frame; a fault in it names the stage alone."""
        self._thread.frame = None
        yield from self._counted(name, items)

    def _counted(self, name: str, items: Iterator[Value]) -> Iterator[Value]:
        thread = self._thread
        while True:
            before, thread.upstream = thread.upstream, 0.0
            start = thread_time()
            try:
                item = next(items, None)
            except WaysideError:
                raise
            except Exception as fault:
                raise StageError(name, thread.frame, fault) from fault
            finally:
                inclusive = thread_time() - start
                self.add(name, inclusive - thread.upstream)
                thread.upstream = before + inclusive
            if item is None:
                return
            yield item


class _ThreadState(threading.local):
    """Of one thread: time that upstream stages took of the call in progress, and the frame handed on last."""

    upstream: float = 0.0
    frame: int | None = None


def result_of(chain: Callable[[Iterator[Source]], Iterator[Result]], item: Source) -> Result:
    """The result of one item.

    Raises StageError where the chain ended without a result or an error that could be raised here.
    """
    try:
        for result in chain(iter([item])):
            return result
    except SystemExit as error:  # raised here, it would end the run as if all were well
        raise StageError("workers", None, error) from error
    raise StageError("workers", None, RuntimeError("a chain has ended without a result"))


def _last_is_done(
    under_way: deque[tuple[Source, Future[Result]]],
    chain: Callable[[Iterator[Source]], Iterator[Result]],
) -> bool:
    """Do the last item that no worker has begun; False if all have been begun."""
    for k in reversed(range(len(under_way))):
        item, waits = under_way[k]
        if waits.cancel():
            under_way[k] = item, done = item, Future[Result]()
            try:
                done.set_result(result_of(chain, item))
            except Exception as fault:  # raised in its turn
                done.set_exception(fault)
            return True
    return False


class Workers(AbstractContextManager["Workers"]):
    """Threads that do the work of a run; the thread that asks is one of them: while it waits, it does the last items.

    One more would wait for the interpreter's lock. Results do not depend on their number. Leaving ends all threads.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool = ThreadPoolExecutor(count - 1, "wayside-") if count > 1 else None

    def __exit__(self, *_: object) -> None:
        """Drop items that wait, and wait for items in progress."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def ordered(
        self,
        chain: Callable[[Iterator[Source]], Iterator[Result]],
        items: Iterator[Source],
        queue: int,
        has_room: Callable[[], bool] = lambda: True,
    ) -> Iterator[Result]:
        """Send items through `chain`, each by itself; results come in the order of the items.

        At most `queue` items a worker are under way: a slow consumer makes the reader wait; so does `has_room` where it
        says no, though one item is always under way. The chain must give one result an item. A fault is raised here,
        after the results before it. Raises StageError as `result_of`.
        """
        if self._pool is None:
            yield from chain(items)
            return
        under_way: deque[tuple[Source, Future[Result]]] = deque()
        while True:
            while len(under_way) < self.count * queue and (not under_way or has_room()):
                item = next(items, None)
                if item is None:
                    break
                under_way.append((item, self._pool.submit(result_of, chain, item)))
            if not under_way:
                return
            if under_way[0][1].done() or not _last_is_done(under_way, chain):
                yield under_way.popleft()[1].result()
