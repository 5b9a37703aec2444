"""A fleet from its logs to the merged inventory."""

import hashlib
import json
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.fleet.engine import DaskEngine, Engine, ProcessEngine, WorkerDeathError
from wayside.pipeline.fleet.folders import is_merged, locked_inventory
from wayside.pipeline.fleet.manifest import (
    DRIVES,
    MANIFEST,
    Entry,
    Manifest,
    State,
    earlier_logs,
    planned_logs,
    write_manifest,
)
from wayside.pipeline.fleet.merging import merge_inventory
from wayside.pipeline.fleet.task import FleetOptions, Task, here, run_task
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.running.journal import result_keys
from wayside.schemas.errors import InterruptionError, StageError, WaysideError
from wayside.schemas.settings import MergeSettings, Settings

_POLL_S, _SAVE_S = 0.5, 2.0

OpenEngine = Callable[[], Engine]
Watch = Callable[[Manifest], None]
WatchMerging = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class FleetReport:
    """What a fleet did."""

    entries: tuple[Entry, ...]
    """The given logs as they are now, in order."""
    kept: frozenset[str]
    """Names of logs that had a result already."""
    copies: tuple[tuple[str, str], ...]
    """Given logs that are the same recording as another one, with the name of that. They count once."""
    left: tuple[str, ...]
    """Names of logs that are not in the inventory any more, because somebody took their results away."""
    merged: str | None
    """What was merged, in words. None: nothing has changed since the last time, or no log is done."""


def run_fleet(
    uris: Sequence[str],
    inventory: Path,
    settings: Settings,
    options: FleetOptions,
    watch: Watch = lambda manifest: None,
    watch_merging: WatchMerging = lambda done, total: None,
    open_engine: OpenEngine | None = None,
    own: Mapping[str, Settings] | None = None,
) -> FleetReport:
    """Run logs into an inventory, those whose results stand excepted, and merge all results of the inventory.

    `uris`: as from `expand_sources`. `inventory`: the folder; logs in it stay in it. `watch`: called every few seconds
    with the given logs. `watch_merging`: called with the number of cells merged and to merge. `open_engine`: another
    engine than the options name. `own`: settings of single logs instead. Raises UsageError for the scheduler or a
    setting, and InputError for a model file or the manifest. Raises OutputError if the inventory cannot be
    written, another fleet writes it, or logs have changed. Raises InterruptionError if somebody ended the fleet; what
    is done stays.
    """
    inventory = inventory.absolute()
    digests, of_log = load_models(settings).digests(), own or {}
    how = {"self_calibrate": options.self_calibrate}
    keys = {one: result_keys(one, digests, **how) for one in {settings, *of_log.values()}}

    def key_of(uri: str, fingerprint: str) -> str:
        return keys[of_log.get(uri, settings)](fingerprint)

    with locked_inventory(inventory):
        earlier, left = earlier_logs(inventory)
        planned, copies = planned_logs(
            uris, earlier, key_of, inventory, retry=options.retry, overwrite=options.overwrite
        )
        book = _Book(inventory, replace(earlier, started=time.time(), where=here()), planned, watch)
        tasks = [
            Task(entry, inventory, of_log.get(entry.source, settings), options)
            for entry in planned.values()
            if entry.state == State.WAITING
        ]
        if tasks:
            _carry_out(tasks, open_engine or _engine_of(options, inventory, len(tasks)), book)
        merged = _merge(inventory, book, settings.merge, watch_merging)
        kept = frozenset(name for name, entry in planned.items() if entry.state == State.DONE)
        gone = tuple(name for name in left if name not in planned)
        return FleetReport(tuple(book.given()), kept, tuple(copies), gone, merged)


class _Book:
    """The manifest of a fleet under way, written every few seconds."""

    def __init__(
        self, inventory: Path, manifest: Manifest, planned: Mapping[str, Entry], watch: Watch
    ) -> None:
        self._inventory, self._watch, self._names = inventory, watch, tuple(planned)
        begun = [
            replace(e, since=manifest.started) if e.state == State.WAITING else e
            for e in planned.values()
        ]
        self.manifest = manifest.with_entries(begun)
        self.save()

    def given(self) -> list[Entry]:
        """The given logs, in order."""
        return [self.manifest.logs[name] for name in self._names]

    def note(self, entry: Entry) -> None:
        """What became of a log just now."""
        self.manifest = self.manifest.with_entries([replace(entry, since=time.time())])
        self._unsaved = True

    def show(self) -> None:
        """Write what is new, if it is time to, and tell who watches how far it is."""
        if self._unsaved and time.time() > self.manifest.updated + _SAVE_S:
            self.save()
        self._watch(replace(self.manifest, logs={entry.name: entry for entry in self.given()}))

    def save(self, **changes: Any) -> None:
        """Write the manifest, with changes of its fields; raises OutputError."""
        self.manifest = replace(self.manifest, updated=time.time(), **changes)
        write_manifest(self._inventory, self.manifest)
        self._unsaved = False


def _carry_out(tasks: Sequence[Task], open_engine: OpenEngine, book: _Book) -> None:
    """Open an engine for tasks. Tasks that an early end interrupts do not count as attempts."""
    under_way: dict[Future[Entry], tuple[Task, int]] = {}
    try:
        with open_engine() as engine:
            _work(engine, tasks, under_way, book)
    except BaseException as error:
        for task, before in under_way.values():
            if task.begun() > before:
                task.note_end()
            book.note(replace(task.entry, attempts=before))
        if isinstance(error, KeyboardInterrupt):
            done = sum(entry.state == State.DONE for entry in book.given())
            raise InterruptionError(
                f"interrupted: {done} of {counted(len(book.given()), 'log')} done. The same command continues from "
                "here."
            ) from error
        raise
    finally:
        book.save()


def _work(
    engine: Engine,
    tasks: Sequence[Task],
    under_way: dict[Future[Entry], tuple[Task, int]],
    book: _Book,
) -> None:
    """Carry tasks out until each is done or in quarantine; `under_way` holds them with their attempts before."""
    waiting, unbegun = deque(tasks), Counter[str]()
    while waiting or under_way:
        while waiting and len(under_way) < engine.places():
            task = waiting.popleft()
            under_way[engine.submit(task)] = task, task.begun()
            book.note(replace(task.entry, state=State.RUNNING))
        wait(under_way, _POLL_S, FIRST_COMPLETED)
        for future in [one for one in under_way if one.done()]:
            task, before = under_way[future]
            try:
                entry = engine.result(future)
            except WorkerDeathError as death:
                unbegun[task.entry.name] += task.begun() <= before
                if unbegun[task.entry.name] >= task.options.attempts:
                    raise WaysideError(
                        f"{task.entry.source}: each worker died before it began this log: {death}"
                    ) from death
                task.note_end(str(death))
                entry = replace(
                    task.entry, status=StageError.exit_status, attempts=before + 1, words=str(death)
                )
            del under_way[future]
            book.note(entry)
            if entry.state == State.WAITING:
                waiting.append(task)
        book.show()


def _engine_of(options: FleetOptions, inventory: Path, tasks: int) -> OpenEngine:
    if options.scheduler is None:
        return lambda: ProcessEngine(run_task, min(options.jobs or 1, tasks))
    scheduler, shared = options.scheduler, inventory / MANIFEST
    return lambda: DaskEngine(run_task, scheduler, options.jobs, shared)


def _merge(
    inventory: Path, book: _Book, settings: MergeSettings, watch: WatchMerging
) -> str | None:
    """Merge finished results if they, the settings or the merged tables have changed. Returns what was merged."""
    merged = book.manifest.results()
    by = hashlib.sha256(json.dumps(asdict(settings)).encode()).hexdigest()
    folders = [inventory / DRIVES / entry.name for entry in book.manifest.done()]
    nothing = not folders and not book.manifest.merged
    same = (book.manifest.merged, book.manifest.merged_by) == (merged, by)
    if nothing or (same and is_merged(inventory)):
        return None
    book.save(merged="")
    report = merge_inventory(folders, inventory, settings, watch)
    book.save(merged=merged, merged_by=by, vectors=report.vectors)
    return str(report)
