"""Sends batches to one recording from a thread of its own, so that no sink can stop or slow a run."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from queue import Full, Queue

import rerun as rr

from wayside.pipeline.view.entities import Batch

THREAD = "view-"
WAITING = 48
"""Sets of batches that wait at most."""
CLOSING_S = 20.0
"""A sink that has not taken everything this long after the run is abandoned."""


def any_alive() -> bool:
    """Whether a recording's thread still runs; after `close`, one that its sink holds for ever."""
    return any(thread.name.startswith(THREAD) for thread in threading.enumerate())


class Recorder:
    """One recording and the thread that fills it; faults end it and are kept, never raised.

    Parameters
    ----------
    name
        For words about it: a file's name or an address.
    open_stream
        Makes the stream with its sink attached; called in the thread.
    patience_s
        How long `put` waits for a full queue before the recording is given up (a file); 0 drops the batches and goes on
        (a live viewer, which shows the next frame instead).
    """

    def __init__(
        self, name: str, open_stream: Callable[[], rr.RecordingStream], patience_s: float
    ) -> None:
        self.name, self.dropped = name, 0
        self.fault: str | None = None
        self._open, self._patience_s = open_stream, patience_s
        self._queue: Queue[Sequence[Batch] | None] = Queue(WAITING)
        self._thread = threading.Thread(target=self._work, name=f"{THREAD}{name}", daemon=True)
        self._thread.start()

    def put(self, batches: Sequence[Batch]) -> None:
        """Hand over batches, of which none can be left out alone."""
        if self.fault is not None:
            return
        try:
            self._queue.put(batches, timeout=self._patience_s or None, block=self._patience_s > 0)
        except Full:
            self.dropped += 1
            if self._patience_s > 0:
                self.fault = f"took nothing for {self._patience_s:g} s"

    def close(self) -> None:
        """Wait until all is written, but not for ever."""
        try:
            self._queue.put(None, timeout=CLOSING_S)
        except Full:
            self.fault = self.fault or f"took nothing for {CLOSING_S:g} s"
            return
        self._thread.join(CLOSING_S)
        if self._thread.is_alive():
            self.fault = self.fault or f"did not end within {CLOSING_S:g} s"

    def _work(self) -> None:
        try:
            stream = self._open()
            while (batches := self._queue.get()) is not None:
                for batch in batches:
                    batch.send(stream)
            stream.flush(timeout_sec=CLOSING_S / 2)
            stream.disconnect()
        except Exception as fault:
            words = str(fault).splitlines() or [""]
            self.fault = f"{type(fault).__name__}: {words[0]}"
            while not self._queue.empty():  # so that `put` does not wait for room
                self._queue.get_nowait()
