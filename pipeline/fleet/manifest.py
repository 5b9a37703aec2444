"""`fleet.json`: every log of an inventory, what it is, what became of it, and in which state a fleet begins with it."""

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, fields, replace
from enum import StrEnum
from importlib.metadata import version
from itertools import chain, count
from pathlib import Path

from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.output_folder import finish_replacement
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.files.writing import write_file
from wayside.pipeline.fleet.sources import (
    UnreachableError,
    fingerprint_source,
    folder_name,
    is_folder_name,
    source_name,
)
from wayside.pipeline.results.result import is_finished, read_run
from wayside.schemas.errors import PARTS_LOST, InputError, OutputError
from wayside.schemas.tables import SIGNS

MANIFEST, DRIVES, LOGS, QUARANTINE = "fleet.json", "drives", "logs", "quarantine"
_READERS = 8
"""Logs and results that are looked at side by side: it is waiting for disks and networks, not computing."""


class State(StrEnum):
    """What became of a log so far."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    QUARANTINED = "quarantined"


ENDED = (State.DONE, State.QUARANTINED)


@dataclass(frozen=True, slots=True)
class Entry:
    """A log of the inventory."""

    name: str
    """Of its folders and files in the inventory; it never changes."""
    source: str
    """Absolute path or URL."""
    fingerprint: str
    """Which recording it is (`log_fingerprint`)."""
    bytes: int
    """Length of the log."""
    key: str | None
    """Digest of the log, settings, models and code that make the result. None: the log could not be read."""
    state: State = State.WAITING
    status: int = 0
    """Exit status of the log alone, once it is done or in quarantine."""
    attempts: int = 0
    """How often it was begun for this key."""
    seconds: float = 0.0
    """Duration of the last attempt."""
    images: int = 0
    """Images read, where it is done."""
    rows: int = 0
    """Rows of `signs.parquet`, where it is done."""
    since: float = 0.0
    """When the state began, seconds since 1970."""
    words: str = ""
    """Why it is in quarantine."""


@dataclass(frozen=True, slots=True)
class Manifest:
    """All logs of an inventory by name, and the fleet that worked on it last."""

    logs: Mapping[str, Entry] = field(default_factory=dict)
    started: float = 0.0
    """When that fleet began, seconds since 1970."""
    updated: float = 0.0
    """When this was written, seconds since 1970."""
    where: str = ""
    """Host and process of that fleet."""
    merged: str = ""
    """`results` at the time of the merged tables. Empty: they are not made, or about to be replaced."""
    merged_by: str = ""
    """Digest of the settings that they were merged by."""
    vectors: Sequence[str] = ()
    """Common difference of all panels of a drive from those of another (`MergeReport`)."""

    def with_entries(self, entries: Iterable[Entry]) -> "Manifest":
        """The same with these entries in the place of those of their names."""
        return replace(self, logs={**self.logs, **{entry.name: entry for entry in entries}})

    def done(self) -> list[Entry]:
        """Logs whose results are part of the inventory, by name."""
        return [entry for _, entry in sorted(self.logs.items()) if entry.state == State.DONE]

    def results(self) -> str:
        """Digest that says which results are part of the inventory now."""
        text = json.dumps([(entry.name, entry.key) for entry in self.done()])
        return hashlib.sha256(text.encode()).hexdigest()


def read_manifest(inventory: Path) -> Manifest:
    """Content of `fleet.json`; raises InputError if it is missing or damaged."""
    file = inventory / MANIFEST
    try:
        content = parse_json(read_input_text(file))
        known = {each.name for each in fields(Entry)}
        logs = {
            name: Entry(
                **{k: v for k, v in entry.items() if k in known} | {"state": State(entry["state"])}
            )
            for name, entry in content["logs"].items()
        }
        for name, entry in logs.items():
            if name != entry.name or not is_folder_name(name):
                raise ValueError(f"the log {name!r} has no name of a folder in the inventory")
        told = {each.name: content[each.name] for each in fields(Manifest) if each.name in content}
        vectors = [str(line) for line in told.get("vectors", ())]
        return Manifest(**told | {"logs": logs, "vectors": vectors})
    except FileNotFoundError as error:
        raise InputError(
            f"{inventory} is not an inventory: it has no {MANIFEST}; `wayside fleet LOGS -o {inventory}` makes one"
        ) from error
    except (OSError, *CONTENT_FAULTS) as error:
        raise InputError(
            f"{file} cannot be read: {error}; it was not written by wayside"
        ) from error


def write_manifest(inventory: Path, manifest: Manifest) -> None:
    """Write `fleet.json`, whole or not at all; raises OutputError."""
    about = asdict(manifest)
    logs = dict(sorted(about.pop("logs").items()))
    text = json.dumps({"wayside": version("wayside")} | about | {"logs": logs}, indent=1) + "\n"
    write_file(inventory / MANIFEST, text.encode(), overwrite=True)


def free_name(uri: str, taken: Collection[str]) -> str:
    """A folder name for a new log: its stem, else with that of its folder before it, else with a number behind it.

    `taken`: names in use, `str.casefold` of each, as some file systems do not tell them apart otherwise.
    """
    stem, parent = source_name(uri)
    first = [stem, f"{parent}_{stem}"] if parent else [stem]
    names = map(folder_name, chain(first, (f"{stem}_{number}" for number in count(2))))
    return next(name for name in names if name.casefold() not in taken)


def finished(folder: Path, entry: Entry) -> Entry:
    """The entry with what `run.json` says of the result in a folder. Raises InputError if it is not a result."""
    run = read_run(folder)
    try:
        counts = run["accounting"]
        return replace(
            entry,
            state=State.DONE,
            status=PARTS_LOST if counts["lost"] else 0,
            seconds=round(float(run["times"]["wall_s"]), 3),
            images=int(counts["frames_read"]),
            rows=int(run["files"][SIGNS.file]["rows"]),
            words="",
        )
    except CONTENT_FAULTS as error:
        raise InputError(
            f"{folder}: the folder does not hold a result of wayside: {error!r}"
        ) from error


def earlier_logs(inventory: Path) -> tuple[Manifest, list[str]]:
    """What the inventory holds, and logs that it held before: somebody took their results away."""
    if not (inventory / MANIFEST).exists():
        return Manifest(), []
    manifest = read_manifest(inventory)
    left = [e.name for e in manifest.done() if not (inventory / DRIVES / e.name).exists()]
    kept = {name: entry for name, entry in manifest.logs.items() if name not in left}
    return replace(manifest, logs=kept), left


def planned_logs(
    uris: Sequence[str],
    earlier: Manifest,
    key_of: Callable[[str, str], str],
    inventory: Path,
    *,
    retry: bool,
    overwrite: bool,
) -> tuple[dict[str, Entry], list[tuple[str, str]]]:
    """The given logs by name with the states in which the fleet begins, and those that are copies of others.

    `key_of`: of a source and its fingerprint.

    A log is known by its source, or by its content where it has moved. Raises OutputError where the content of logs
    has changed and their results are not to be replaced.
    """
    by_source = {entry.source: entry for entry in earlier.logs.values()}
    by_content = {e.fingerprint: e for e in earlier.logs.values() if e.fingerprint}
    taken = {name.casefold() for name in earlier.logs}
    planned: dict[str, Entry] = {}
    copies: list[tuple[str, str]] = []
    changed: list[str] = []
    with ThreadPoolExecutor(_READERS) as readers:
        looked = list(zip(uris, readers.map(_looked_at, uris), strict=True))
        for uri, found in sorted(looked, key=lambda pair: isinstance(pair[1], str)):
            known = by_source.get(uri)
            if not isinstance(found, str):
                if known is not None and known.fingerprint not in ("", found[0]):
                    changed.append(uri)
                known = known or by_content.get(found[0])
            name = free_name(uri, taken) if known is None else known.name
            if name in planned:
                copies.append((uri, name))
                continue
            taken.add(name.casefold())
            planned[name] = _begun_with(name, uri, known, found, key_of)
            by_content[planned[name].fingerprint] = planned[name]
        if changed and not overwrite:
            some = ", ".join(changed[:3]) + (", ..." if len(changed) > 3 else "")
            raise OutputError(
                f"{len(changed)} of the logs that {inventory} holds have changed: {some}. Give them other names to "
                "add them, or replace their results with --overwrite."
            )
        standing = readers.map(
            lambda entry: _standing(inventory, entry, earlier.logs.get(entry.name), retry=retry),
            planned.values(),
        )
        return {entry.name: entry for entry in standing}, copies


def _looked_at(uri: str) -> tuple[str, int] | str:
    try:
        return fingerprint_source(uri)
    except UnreachableError as error:
        return str(error)


def _begun_with(
    name: str,
    uri: str,
    known: Entry | None,
    found: tuple[str, int] | str,
    key_of: Callable[[str, str], str],
) -> Entry:
    """A log as waiting, or in quarantine because it cannot be read (`found`)."""
    if not isinstance(found, str):
        return Entry(name, uri, *found, key_of(uri, found[0]))
    content, size = ("", 0) if known is None else (known.fingerprint, known.bytes)
    key = key_of(uri, content) if content else None
    return Entry(
        name, uri, content, size, key, State.QUARANTINED, InputError.exit_status, words=found
    )


def _standing(inventory: Path, entry: Entry, known: Entry | None, *, retry: bool) -> Entry:
    """The entry as done where its result stands, as in quarantine where it was put there, else as it is."""
    folder = inventory / DRIVES / entry.name
    finish_replacement(folder)
    same = known if known is not None and known.key == entry.key else None
    if is_finished(folder, entry.key):
        if same is not None and same.state == State.DONE:
            return replace(same, source=entry.source)
        return finished(folder, entry)
    if same is None or same.state != State.QUARANTINED or not same.attempts or retry:
        return entry
    return replace(same, source=entry.source) if entry.state == State.WAITING else entry
