"""The engine of `--scheduler`: Dask distributed, on this machine or on a cluster."""

from __future__ import annotations

import os
import queue
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from wayside.schemas.errors import OutputError, UsageError

T = TypeVar("T")
R = TypeVar("R")
LOCAL = "local"
_CONNECT_S = 30


class DaskEngine(Generic[T, R]):
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

    def __init__(
        self, run: Callable[[T], R], scheduler: str, jobs: int | None, shared: Path
    ) -> None:
        try:
            import distributed
        except ImportError as error:
            raise UsageError(
                f"--scheduler: wanted Dask distributed, found: {error}; `pip install 'wayside[fleet]'`, "
                "or leave --scheduler out: processes of this machine do the same"
            ) from error
        self._run, self._jobs = run, jobs
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._under_way: dict[str, tuple[Any, T]] = {}
        self._number = 0
        dask: Any = distributed  # it has no types
        self._cluster = None
        if scheduler == LOCAL:
            self._cluster = dask.LocalCluster(
                n_workers=jobs or 1,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address=None,
            )
        try:
            self._client: Any = dask.Client(self._cluster or scheduler, timeout=_CONNECT_S)
            self._client.wait_for_workers(1, timeout=_CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise UsageError(
                f"--scheduler {scheduler}: wanted a Dask scheduler with workers, found: {error}; start one with "
                "`dask scheduler` and `dask worker ADDRESS --nthreads 1`, or say --scheduler local"
            ) from error
        blind = [a for a, seen in self._client.run(os.path.isfile, str(shared)).items() if not seen]
        if blind:
            self.__exit__(None, None, None)
            raise OutputError(
                f"{shared}: wanted a folder that all workers see, found that {', '.join(blind)} do not; "
                "put the inventory on a shared file system"
            )

    def places(self) -> int:
        """As of `Engine`; workers may come and go."""
        threads: int = sum(self._client.nthreads().values())
        return threads if self._jobs is None else min(threads, self._jobs)

    def submit(self, task: T) -> None:
        """As of `Engine`."""
        self._number += 1
        future = self._client.submit(self._run, task, pure=False, key=f"wayside-{self._number}")
        self._under_way[future.key] = (future, task)
        future.add_done_callback(self._ended.put)

    def wait(self, timeout_s: float) -> list[tuple[T, R | str]]:
        """As of `Engine`. Dask gives a task to another worker by itself; it ends here when it has done so too often."""
        from distributed import KilledWorker

        ended: list[tuple[T, R | str]] = []
        try:
            future = self._ended.get(timeout=timeout_s)
            while True:
                _, task = self._under_way.pop(future.key)
                error = future.exception() if future.status == "error" else None
                if error is not None and not isinstance(error, KilledWorker):
                    raise error
                lost = f"its workers died: {error or 'the scheduler lost it'}"
                ended.append((task, future.result() if future.status == "finished" else lost))
                future.release()
                future = self._ended.get_nowait()
        except queue.Empty:
            return ended

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take back what has not begun; what runs on another machine goes to its end."""
        with suppress(
            Exception
        ):  # Dask fails to stop a worker that is being restarted: results are on the disk
            self._client.cancel([future for future, _ in self._under_way.values()])
        for part in (self._client, self._cluster):
            with suppress(Exception):
                if part is not None:
                    part.close()
