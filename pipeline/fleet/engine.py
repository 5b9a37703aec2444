"""Who carries the tasks of a fleet out: processes of this machine, or the workers of a Dask scheduler.

Both give futures of `concurrent.futures`. An engine is given as many tasks as it has places, so that a worker that dies
takes only its own task along.
"""

import multiprocessing.connection
import os
import signal
import sys
import threading
import time
from abc import abstractmethod
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from wayside.pipeline.fleet.manifest import Entry
from wayside.pipeline.fleet.task import Task
from wayside.pipeline.running.process import interrupt_on_signals
from wayside.schemas.errors import INTERRUPTED, OutputError, UsageError, WaysideError

Run = Callable[[Task], Entry]
LOCAL = "local"
_PATIENCE_S, _CONNECT_S = 10.0, 30
_MANY = 1 << 30


class WorkerDeathError(WaysideError):
    """How the worker of a task died, in words."""


class Engine(AbstractContextManager["Engine"]):
    """Carries tasks out side by side, in any order; leaving the block ends what is under way.

    `run`: a function that another process can import. `jobs`: tasks side by side.
    """

    def __init__(self, run: Run, jobs: int) -> None:
        self._run, self._jobs = run, jobs

    def places(self) -> int:
        """How many tasks it takes at a time, now."""
        return self._jobs

    @abstractmethod
    def submit(self, task: Task) -> Future[Entry]:
        """Begin a task; to be called while fewer than `places` are under way."""

    def result(self, future: Future[Entry]) -> Entry:
        """What became of the task of a future that is done; raises WorkerDeathError where its worker died."""
        return future.result()


class ProcessEngine(Engine):
    """Worker processes on this machine, each for many tasks one after the other; a dead one is replaced."""

    def __init__(self, run: Run, jobs: int) -> None:
        super().__init__(run, jobs)
        self._threads = ThreadPoolExecutor(jobs)
        self.workers: dict[BaseProcess, Connection] = {}
        self._idle: list[BaseProcess] = []

    def submit(self, task: Task) -> Future[Entry]:
        """As of `Engine`; a worker is started where none waits."""
        worker = self._idle.pop() if self._idle else self._start()
        return self._threads.submit(self._ask, worker, task)

    def _start(self) -> BaseProcess:
        context = multiprocessing.get_context("spawn")  # nothing of this process is shared
        ours, theirs = context.Pipe()
        worker = context.Process(target=_serve, args=(self._run, theirs))
        worker.start()
        theirs.close()
        self.workers[worker] = ours
        return worker

    def _ask(self, worker: BaseProcess, task: Task) -> Entry:
        """Let a worker carry a task out, and wait for it."""
        try:
            self.workers[worker].send(task)
            outcome, error = self.workers[worker].recv()
        except (EOFError, OSError) as end:
            worker.join()
            del self.workers[worker]
            raise WorkerDeathError(_death(worker.exitcode)) from end
        self._idle.append(worker)
        if error is not None:
            raise error
        entry: Entry = outcome
        return entry

    def __exit__(self, *_: object) -> None:
        """Ask all workers to end, and wait until they have."""
        late = time.monotonic() + _PATIENCE_S
        for worker in (workers := list(self.workers)):
            worker.terminate()
        for worker in workers:
            worker.join(max(late - time.monotonic(), 0))
            worker.kill()
        self._threads.shutdown()


def _death(code: int | None) -> str:
    """How a process ended, in words, by its exit code."""
    if code == INTERRUPTED:
        return "its worker was told to stop"
    if code is None or code >= 0:
        return f"its worker ended with exit status {code}"
    with suppress(ValueError):
        return f"its worker was killed by {signal.Signals(-code).name}"
    return f"its worker was killed by signal {-code}"


def _serve(run: Run, tasks: Connection) -> None:
    """Carry out the tasks that come through a pipe, until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that gave the tasks
    interrupt_on_signals()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        while True:
            task = tasks.recv()
            try:
                answer: tuple[Entry | None, Exception | None] = run(task), None
            except Exception as error:
                answer = None, error
            tasks.send(answer)
    except EOFError:
        return
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _end_with_parent() -> None:
    """Do not go on with work that nobody waits for."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_PATIENCE_S)
        os._exit(1)


class DaskEngine(Engine):
    """Tasks on the workers of a Dask scheduler, an address such as `tcp://host:8786`.

    With `local` they are workers on this machine that listen on the loopback address. `jobs`: workers of `local`, or
    the most tasks at a time of another scheduler. None: one for each of its threads. Raises UsageError where there is
    no Dask distributed, or no scheduler with workers at that address, and OutputError where a worker does not see the
    file shared.
    """

    def __init__(self, run: Run, scheduler: str, jobs: int | None, shared: Path) -> None:
        try:
            import distributed
        except ImportError as error:
            raise UsageError(
                f"--scheduler: Dask distributed cannot be loaded: {error}. Install it with `pip install "
                "'wayside[fleet]'`, or leave --scheduler out to use processes of this machine."
            ) from error
        super().__init__(run, jobs or _MANY)
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
        return min(threads, self._jobs)

    def submit(self, task: Task) -> Future[Entry]:
        """As of `Engine`."""
        future: Future[Entry] = self._executor.submit(self._run, task)
        return future

    def result(self, future: Future[Entry]) -> Entry:
        """As of `Engine`. Dask gives a task to another worker by itself; it ends here when it has done so too often."""
        if future.cancelled():
            raise WorkerDeathError("its workers died: the scheduler lost it")
        try:
            return future.result()
        except self._dask.KilledWorker as error:
            raise WorkerDeathError(f"its workers died: {error}") from error

    def __exit__(self, *_: object) -> None:
        """Take back what has not begun; what runs on another machine goes to its end."""
        ends = [lambda: self._executor.shutdown(wait=False), self._client.close]
        for end in ends if self._cluster is None else [*ends, self._cluster.close]:
            with suppress(Exception):  # Dask fails to stop a worker that is being restarted
                end()
