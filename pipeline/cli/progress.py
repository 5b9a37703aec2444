"""Progress of long work on stderr: a bar on a terminal, else a line every ten seconds."""

import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.fleet.manifest import ENDED, Manifest
from wayside.pipeline.fleet.status import describe_progress

if TYPE_CHECKING:
    from wayside.pipeline.running.run import Run

COMPILING = "compiling, once after installation"
_LONGEST_LABEL = 16
_TOLD_S = 10.0


class _Bar(Progress):
    """Asks how far the work is each time it is drawn."""

    refreshed: Callable[[], None] = staticmethod(lambda: None)

    def get_renderables(self) -> Iterable[RenderableType]:
        """The bar with the counts of this moment."""
        self.refreshed()
        yield from super().get_renderables()


class _TimeLeft(ProgressColumn):
    """Time left by the speed of the last half minute; nothing before it is known and behind the last piece."""

    max_refresh = 0.5

    def render(self, task: Task) -> Text:
        """Hours, minutes and seconds."""
        left = None if task.finished else task.time_remaining
        words = "" if left is None else f"{timedelta(seconds=int(left))} left"
        return Text(f"{words:>12}")


class _TimeTaken(ProgressColumn):
    """Time since the beginning; that of Rich stands still once all is done, though counting may begin again."""

    def render(self, task: Task) -> Text:
        """Hours, minutes and seconds."""
        return Text(str(timedelta(seconds=int(task.elapsed or 0))))


class _Shown:
    """A bar on stderr while its block runs; `what` says how far the work is."""

    def __init__(self, label: str, *what: ProgressColumn, **fields: Any) -> None:
        self._console = Console(stderr=True)
        self._bar = _Bar(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            *what,
            console=self._console,
            disable=not self._console.is_terminal,
            redirect_stdout=sys.stdout.isatty(),
            transient=True,
        )
        self._label, self._told, self._ended = label, False, threading.Event()
        self._task = self._bar.add_task(label, total=None, **fields)

    def __enter__(self) -> Self:
        self._bar.start()
        if self._bar.disable:
            threading.Thread(target=self._tell, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._bar.stop()

    def _tell(self) -> None:
        """Print what the bar would show, until the work ends."""
        while not self._ended.wait(_TOLD_S):
            self._bar.refreshed()
            columns = (c for c in self._bar.columns if isinstance(c, ProgressColumn))
            shown = (c(self._bar.tasks[0]) for c in columns if not isinstance(c, BarColumn))
            words = (str(one).strip() for one in shown)
            print(*filter(None, words), file=sys.stderr, flush=True)

    def compiling(self, active: bool) -> None:
        """Say that kernels are compiled, so that a first run explains its minute; where no bar is shown, in a line."""
        self._bar.update(self._task, description=COMPILING if active else self._label)
        if self._bar.disable and active and not self._told:
            self._told = True
            self._console.print(f"wayside: {COMPILING}, takes less than a minute", soft_wrap=True)


class FrameProgress(_Shown):
    """Shows how many images are analysed, how many are finished, which comes later, and the time left."""

    def __init__(self, label: str, run: "Run") -> None:
        name = visible(label)  # shortened, it leaves room for the counts on a line of 80 columns
        shown = name if len(name) <= _LONGEST_LABEL else f"{name[: _LONGEST_LABEL - 3]}..."
        counts = TextColumn(
            "{task.fields[looked_at]} searched, {task.fields[settled]} of {task.fields[held]} done"
        )
        super().__init__(escape(shown), counts, _TimeLeft(), looked_at=0, settled=0, held="?")
        self._run = run
        self._bar.refreshed = self._refresh

    def _refresh(self) -> None:
        """An analysed image is half done: only both counts together rise evenly."""
        counts, held = self._run.counts, self._run.report.images_held
        if held:
            done, shown = counts.looked_at + counts.settled, asdict(counts) | {"held": held}
            self._bar.update(self._task, total=2 * held, completed=done, **shown)


class SheetProgress(_Shown):
    """Shows how many of a known number of sheets, or of something else, are done."""

    def __init__(self, label: str, things: str = "sheets") -> None:
        super().__init__(label, MofNCompleteColumn(), TextColumn(things), _TimeTaken())

    def watch(self, done: int, total: int | None) -> None:
        """So many are done."""
        self._bar.update(self._task, completed=done, total=total)


class FleetProgress(_Shown):
    """Shows how far a fleet is."""

    def __init__(self) -> None:
        super().__init__("fleet", TextColumn("{task.fields[words]}"), _TimeTaken(), words="")

    def watch(self, manifest: Manifest) -> None:
        """The logs are so far."""
        done = sum(entry.bytes for entry in manifest.logs.values() if entry.state in ENDED)
        total = sum(entry.bytes for entry in manifest.logs.values())
        self._show(done, total, describe_progress(manifest, time.time()))

    def watch_merging(self, done: int, total: int) -> None:
        """So many cells of the inventory are merged."""
        self._show(done, total, f"merging: {done} of {total} cells")

    def _show(self, done: int, total: int, words: str) -> None:
        self._bar.update(self._task, completed=done, total=max(total, 1), words=words)
