"""Progress of long work on stderr: a bar for a person, silence in a pipe."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from wayside.pipeline.fleet.manifest import ENDED, Manifest
from wayside.pipeline.fleet.status import figures_of
from wayside.pipeline.reading.frames import ReadReport
from wayside.pipeline.visible_text import visible
from wayside.schemas.landmarks import TrackedFrame

COMPILING = "compiling, once after installation"
_TOLD_S = 60.0


class _Shown:
    """A bar on stderr while its block runs; `what` says how far the work is."""

    def __init__(self, *what: ProgressColumn) -> None:
        console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            *what,
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()


class FrameProgress(_Shown):
    """Shows images done, their rate and the time left, estimated from the bytes read."""

    def __init__(self, label: str, total_bytes: int) -> None:
        super().__init__(
            TextColumn("{task.fields[frames]} images, {task.fields[rate]:.1f}/s"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        self._label = label = escape(visible(label))
        self._task = self._bar.add_task(label, total=max(total_bytes, 1), frames=0, rate=0.0)
        self._frames = 0

    def watch(self, settled: TrackedFrame, report: ReadReport) -> None:
        """One more image is done; what was read of the log so far tells how much is left."""
        self._frames += 1
        elapsed = self._bar.tasks[0].elapsed or 0.0
        rate = self._frames / elapsed if elapsed > 0 else 0.0
        self._bar.update(self._task, completed=report.bytes_read, frames=self._frames, rate=rate)

    @property
    def description(self) -> str:
        """What stands at the start of the line: the label, or that kernels are compiled."""
        return self._bar.tasks[0].description

    def compiling(self, active: bool) -> None:
        """Say that kernels are compiled, in place of the label, so that a first run explains its minute."""
        self._bar.update(self._task, description=COMPILING if active else self._label)


class SheetProgress(_Shown):
    """Shows how many of a known number of sheets, or of something else, are done."""

    def __init__(self, label: str, things: str = "sheets") -> None:
        counted = f"{{task.completed}} of {{task.total}} {things}"
        super().__init__(TextColumn(counted), TimeElapsedColumn())
        self._task = self._bar.add_task(label, total=None)

    def watch(self, done: int, total: int) -> None:
        """So many are done."""
        self._bar.update(self._task, completed=done, total=total)


class FleetProgress(_Shown):
    """Shows how far a fleet is; where nobody looks, as a line every minute."""

    def __init__(self) -> None:
        super().__init__(TextColumn("{task.fields[words]}"), TimeElapsedColumn())
        self._task = self._bar.add_task("fleet", total=None, words="")
        self._told = time.monotonic()

    def watch(self, manifest: Manifest) -> None:
        """The logs are so far."""
        figures = figures_of(manifest, time.time())
        done = sum(entry.bytes for entry in manifest.logs.values() if entry.state in ENDED)
        total = sum(entry.bytes for entry in manifest.logs.values())
        self._bar.update(self._task, completed=done, total=max(total, 1), words=str(figures))
        if self._bar.disable and time.monotonic() > self._told + _TOLD_S:
            self._told = time.monotonic()
            print(figures, file=sys.stderr, flush=True)
