"""Who carries the tasks of a fleet out: processes of this machine, or the workers of a Dask scheduler.

Both give futures of `concurrent.futures`. An engine is given as many tasks as it has places, so that a worker that dies
takes only its own task along.
"""

from __future__ import annotations

import multiprocessing.connection
import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, suppress
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Protocol

from wayside.pipeline.fleet.task import Outcome, Task
from wayside.pipeline.running.process import interrupt_on_signals
from wayside.schemas.errors import OutputError, UsageError

Run = Callable[[Task], Outcome]
LOCAL = "local"
_PATIENCE_S, _CONNECT_S = 10.0, 30


class Engine(Protocol):
    """Carries tasks out side by side, in any order; leaving the block ends what is under way."""

    def places(self) -> int:
        """How many tasks it takes at a time, now."""

    def submit(self, task: Task) -> Future[Outcome]:
        """Begin a task; to be called while fewer than `places` are under way."""

    def death(self, future: Future[Outcome]) -> str | None:
        """How the worker of a future that is done died, in words; None: it did not."""


class ProcessEngine(AbstractContextManager["ProcessEngine"]):
    """Worker processes on this machine, each for many tasks one after the other; a dead one is replaced.

    Each is a pool of its own, as a pool breaks as a whole where one of its processes dies.

    Parameters
    ----------
    run
        A function that another process can import.
    jobs
        Processes side by side.
    """

    def __init__(self, run: Run, jobs: int) -> None:
        self._run, self._jobs = run, jobs
        self._pools: dict[ProcessPoolExecutor, tuple[set[BaseProcess], Future[Outcome]]] = {}

    def places(self) -> int:
        """As of `Engine`."""
        return self._jobs

    def submit(self, task: Task) -> Future[Outcome]:
        """As of `Engine`; a worker is started where none waits."""
        for pool in [pool for pool, (_, last) in self._pools.items() if last.done()]:
            processes, _ = self._pools.pop(pool)
            with suppress(BrokenProcessPool):
                self._pools[pool] = processes, pool.submit(self._run, task)
                return self._pools[pool][1]
        others = set(multiprocessing.active_children())
        # nothing of this process is shared
        pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _prepare)
        future = pool.submit(self._run, task)
        self._pools[pool] = set(multiprocessing.active_children()) - others, future
        return future

    def death(self, future: Future[Outcome]) -> str | None:
        """As of `Engine`."""
        error = future.exception()
        if isinstance(error, KeyboardInterrupt):
            return "its worker was asked to end"
        if not isinstance(error, BrokenProcessPool):
            return None
        pool = next(pool for pool, (_, last) in self._pools.items() if last is future)
        processes, _ = self._pools.pop(pool)
        pool.shutdown()  # it waits for the process; two threads that do are not both told how it ended
        code = next((process.exitcode for process in processes), None)
        if code is None or code >= 0:
            return (
                "its worker died" if code is None else f"its worker ended with exit status {code}"
            )
        with suppress(ValueError):
            return f"its worker was ended by {signal.Signals(-code).name}"
        return f"its worker was ended by signal {-code}"

    def __exit__(self, *_: object) -> None:
        """Ask all workers to end, and wait until they have."""
        busy = {last: processes for processes, last in self._pools.values() if not last.done()}
        for process in (one for processes in busy.values() for one in processes):
            process.terminate()
        for future in wait(busy, _PATIENCE_S).not_done:
            for process in busy[future]:
                process.kill()
        for pool in self._pools:
            pool.shutdown()


def _prepare() -> None:
    """Make a new worker process end as the fleet wants it to."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that gave the tasks
    interrupt_on_signals()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Do not go on with work that nobody waits for."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_PATIENCE_S)
        os._exit(1)  # a worker of a pool would wait for its next task for ever


class DaskEngine(AbstractContextManager["DaskEngine"]):
    """Tasks on the workers of a Dask scheduler.

    Parameters
    ----------
    run
        A function that the workers can import.
    scheduler
        Address such as `tcp://host:8786`, or `local`: workers on this machine that listen on the loopback address.
    jobs
        Workers of `local`; of another scheduler at most so many tasks at a time, None: one for each of its threads.
    shared
        A file that all workers must see where it is.

    Raises
    ------
    UsageError
        Dask distributed is not installed, or there is no scheduler with workers at that address.
    OutputError
        A worker does not see the shared file.
    """

    def __init__(self, run: Run, scheduler: str, jobs: int | None, shared: Path) -> None:
        try:
            import distributed
        except ImportError as error:
            raise UsageError(
                f"--scheduler: Dask distributed cannot be loaded: {error}. Install it with `pip install "
                "'wayside[fleet]'`, or leave --scheduler out to use processes of this machine."
            ) from error
        self._run, self._jobs = run, jobs
        self._dask: Any = distributed  # it has no types
        self._cluster = None
        if scheduler == LOCAL:
            self._cluster = self._dask.LocalCluster(
                n_workers=jobs or 1, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
            )
        try:
            self._client = self._dask.Client(self._cluster or scheduler, timeout=_CONNECT_S)
            self._client.wait_for_workers(1, timeout=_CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise UsageError(
                f"--scheduler {scheduler}: no Dask scheduler with workers answers: {error}. Start one with `dask "
                "scheduler` and `dask worker ADDRESS --nthreads 1`, or give --scheduler local."
            ) from error
        self._executor = self._client.get_executor(pure=False)
        blind = [a for a, seen in self._client.run(os.path.isfile, str(shared)).items() if not seen]
        if blind:
            self.__exit__()
            raise OutputError(
                f"{shared}: the workers {', '.join(blind)} do not see this folder. Put the inventory on a shared file "
                "system."
            )

    def places(self) -> int:
        """As of `Engine`; workers may come and go."""
        threads: int = sum(self._client.nthreads().values())
        return threads if self._jobs is None else min(threads, self._jobs)

    def submit(self, task: Task) -> Future[Outcome]:
        """As of `Engine`."""
        future: Future[Outcome] = self._executor.submit(self._run, task)
        return future

    def death(self, future: Future[Outcome]) -> str | None:
        """As of `Engine`. Dask gives a task to another worker by itself; it ends here when it has done so too often."""
        if future.cancelled():
            return "its workers died: the scheduler lost it"
        error = future.exception()
        return f"its workers died: {error}" if isinstance(error, self._dask.KilledWorker) else None

    def __exit__(self, *_: object) -> None:
        """Take back what has not begun; what runs on another machine goes to its end."""
        ends = [lambda: self._executor.shutdown(wait=False), self._client.close]
        for end in ends if self._cluster is None else [*ends, self._cluster.close]:
            with suppress(Exception):  # Dask fails to stop a worker that is being restarted
                end()
