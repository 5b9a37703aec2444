"""Who carries the tasks of a fleet out: processes of its own on this machine, or a Dask cluster.

An engine is given as many tasks as it has places, so that what a worker that dies takes with it is what it was at.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Generic, Protocol, Self, TypeVar

from wayside.pipeline.process import interrupt_on_signals

T = TypeVar("T")
R = TypeVar("R")
_PATIENCE_S = 10.0


class Engine(Protocol[T, R]):
    """Carries tasks out side by side, in any order; leaving the block ends what is under way."""

    def places(self) -> int:
        """How many tasks it takes at a time, now."""

    def submit(self, task: T) -> None:
        """Begin a task; to be called while fewer than `places` are under way."""

    def wait(self, timeout_s: float) -> list[tuple[T, R | str]]:
        """Tasks that have ended since, with their results, or how their workers died; none after the timeout.

        Raises what a task raised.
        """

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class ProcessEngine(Generic[T, R]):
    """Worker processes on this machine, each for many tasks one after the other; a dead one is replaced.

    Parameters
    ----------
    run
        A function that another process can import.
    jobs
        Processes side by side.
    """

    def __init__(self, run: Callable[[T], R], jobs: int) -> None:
        self._run, self._jobs = run, jobs
        self._idle: list[_Worker[T, R]] = []
        self._busy: dict[Connection, tuple[_Worker[T, R], T]] = {}

    def places(self) -> int:
        """As of `Engine`."""
        return self._jobs

    def submit(self, task: T) -> None:
        """As of `Engine`; a worker is started where none waits."""
        worker = self._idle.pop() if self._idle else _Worker(self._run)
        with suppress(BrokenPipeError):  # it died while it waited; `wait` finds out
            worker.connection.send(task)
        self._busy[worker.connection] = (worker, task)

    def wait(self, timeout_s: float) -> list[tuple[T, R | str]]:
        """As of `Engine`."""
        ended: list[tuple[T, R | str]] = []
        for ready in wait(list(self._busy), timeout_s):
            assert isinstance(ready, Connection)
            worker, task = self._busy.pop(ready)
            try:
                result, error = ready.recv()
            except (EOFError, OSError):
                ended.append((task, worker.end()))
                continue
            self._idle.append(worker)
            if error is not None:
                raise error
            ended.append((task, result))
        return ended

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ask all workers to end, and wait until they have."""
        workers = [*self._idle, *(worker for worker, _ in self._busy.values())]
        self._idle, self._busy = [], {}
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.end()


class _Worker(Generic[T, R]):
    """A process that waits for tasks, and the pipe to it."""

    def __init__(self, run: Callable[[T], R]) -> None:
        context = multiprocessing.get_context("spawn")  # nothing of this process is shared
        self.connection, there = context.Pipe()
        self.process = context.Process(target=_serve, args=(there, run), daemon=True)
        self.process.start()
        there.close()  # so that its death is the end of the pipe

    def end(self) -> str:
        """Wait until the process has ended, or end it; how it did, in words."""
        self.connection.close()
        self.process.join(_PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        code = self.process.exitcode or 0
        if code >= 0:
            return f"its worker ended with exit status {code}"
        with suppress(ValueError):
            return f"its worker was ended by {signal.Signals(-code).name}"
        return f"its worker was ended by signal {-code}"


def _serve(connection: Connection, run: Callable[[T], R]) -> None:
    """Carry tasks out until the pipe ends; what `run` raises is sent back."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that gave the tasks
    interrupt_on_signals()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, BrokenPipeError, ConnectionResetError, KeyboardInterrupt):
        while True:
            task = connection.recv()
            try:
                answer: tuple[R | None, Exception | None] = (run(task), None)
            except Exception as error:
                answer = (None, error)
            connection.send(answer)


def _end_with_parent() -> None:
    """Do not go on with work that nobody waits for."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)
