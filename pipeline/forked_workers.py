"""Workers as processes, which share no interpreter lock: forks of the process of a run.

Large arrays come back in memory that all of them see. A fork copies no thread of its process, and a lock that another
thread holds at that moment stays locked in it. So a program asks for them, not the library.
"""

import gc
import mmap
import multiprocessing
import pickle
import signal
import sys
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import Any

import numpy as np

from wayside.pipeline.workers import Result, Source, StageClock, Workers, result_of
from wayside.schemas.errors import StageError
from wayside.stages.classifiers import providers

ROOMS, ROOM_BYTES = (64, 64), 1 << 26
"""Room for the first and for the second large array of so many results, and bytes of each. Only what was written takes
memory. An array that finds no room is sent through the pipe."""
LEAST_BYTES = 1 << 18
"""Smaller arrays are sent through the pipe."""
_UNRESERVED = 0x4000
"""MAP_NORESERVE of Linux, which `mmap` has from Python 3.13."""


def can_fork() -> bool:
    """Whether this system forks safely, and networks run on no graphics card, which a fork cannot use."""
    return sys.platform == "linux" and "CUDAExecutionProvider" not in providers()


class ForkedWorkers(Workers):
    """As `Workers`, by processes, which the second item starts; `clock` counts what their stages take, too."""

    def __init__(self, count: int, clock: StageClock) -> None:
        super().__init__(count)
        self._clock, self._rooms = clock, Rooms()
        self._processes, self._pipes = list[BaseProcess](), list[Connection]()
        self._idle = SimpleQueue[Connection]()

    def __exit__(self, *error: object) -> None:
        """Drop items that wait, and wait for those in progress and for the ends of the processes."""
        super().__exit__()
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.join()

    def _elsewhere(
        self, chain: Callable[[Iterator[Source]], Iterator[Result]]
    ) -> Callable[[Source], Result]:
        context = multiprocessing.get_context("fork")
        gc.freeze()  # a search for garbage writes to all objects, and a page that is written to is copied
        for _ in range(self.count - 1):
            ours, theirs = context.Pipe()
            self._pipes.append(ours)
            self._processes.append(context.Process(target=self._serve, args=(chain, theirs)))
            self._processes[-1].start()
            theirs.close()
            self._idle.put(ours)

        def ask(item: Source) -> Result:
            pipe, rooms = self._idle.get(), self._rooms.taken()
            try:
                pipe.send((item, rooms))
                answer = pipe.recv()
            except (EOFError, OSError) as end:
                lost = RuntimeError("a worker process has ended, perhaps for lack of memory")
                raise StageError("workers", item.frame.index, lost) from end
            finally:
                self._idle.put(pipe)
            content, lengths, seconds = answer or (b"", [], {})
            arrays = self._rooms.read(rooms, lengths)
            for stage, spent in seconds.items():
                self._clock.add(stage, spent)
            result: Result = (
                pickle.loads(content, buffers=arrays) if answer else result_of(chain, item)
            )
            return result

        return ask

    def _serve(self, chain: Callable[[Iterator[Any]], Iterator[Any]], pipe: Connection) -> None:
        """Answer with results until the pipe is closed; with None for a fault, which the one who asks meets again."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)  # the process that asks closes the pipe
        for other in self._pipes:
            other.close()
        with suppress(EOFError):
            while True:
                (item, rooms), before, answer = pipe.recv(), self._clock.seconds(), None
                with suppress(Exception):
                    content, lengths = self._rooms.written(rooms, result_of(chain, item))
                    after = self._clock.seconds().items()
                    spent = {stage: seconds - before.get(stage, 0.0) for stage, seconds in after}
                    answer = content, lengths, spent
                pipe.send(answer)


class Rooms:
    """Memory that a process and its forks see, in parts for one large array each; the process gives them out."""

    def __init__(self) -> None:
        self._memory, self.free = mmap.mmap(-1, 1), list[list[int]]()
        with suppress(OSError):  # a system that reserves all memory that is asked for
            flags = mmap.MAP_SHARED | mmap.MAP_ANONYMOUS | _UNRESERVED
            self._memory = mmap.mmap(-1, sum(ROOMS) * ROOM_BYTES, flags)
            self.free = [list(range(ROOMS[0])), list(range(ROOMS[0], sum(ROOMS)))]

    def taken(self) -> list[tuple[int, int]]:
        """Rooms for the arrays of one result: which list they are of, and their numbers."""
        return [(k, free.pop()) for k, free in enumerate(self.free) if free]

    def written(self, rooms: list[tuple[int, int]], result: object) -> tuple[bytes, list[int]]:
        """The result without its first large arrays, and the lengths of these, which are in `rooms`."""
        lengths: list[int] = []

        def is_small(buffer: pickle.PickleBuffer) -> bool:
            content = buffer.raw()
            if len(lengths) == len(rooms) or not LEAST_BYTES <= content.nbytes <= ROOM_BYTES:
                return True
            start = rooms[len(lengths)][1] * ROOM_BYTES
            self._memory[start : start + content.nbytes] = content
            lengths.append(content.nbytes)
            return False

        return pickle.dumps(result, protocol=5, buffer_callback=is_small), lengths

    def read(self, rooms: list[tuple[int, int]], lengths: list[int]) -> list[Any]:
        """The arrays in the first rooms; a room is free again as soon as nothing holds its array."""
        arrays = []
        for n, (k, room) in enumerate(rooms):
            length = lengths[n] if n < len(lengths) else 0
            array = np.frombuffer(self._memory, np.uint8, length, room * ROOM_BYTES)
            weakref.finalize(array, self.free[k].append, room)
            arrays.append(array)
        return arrays[: len(lengths)]
