"""Which logs a fleet begins with, and in which state: known, moved, changed, copies, unreadable."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path

from wayside.pipeline.files.output_folder import finish_replacement
from wayside.pipeline.fleet.manifest import (
    DONE,
    DRIVES,
    MANIFEST,
    QUARANTINED,
    Entry,
    Manifest,
    free_name,
    read_manifest,
)
from wayside.pipeline.fleet.sources import UnreachableError, fingerprint_source
from wayside.pipeline.fleet.task import finished_outcome
from wayside.pipeline.results.earlier_result import is_finished
from wayside.schemas.errors import InputError, OutputError

_READERS = 8
"""Logs and results that are looked at side by side: it is waiting for disks and networks, not computing."""


def earlier_logs(inventory: Path) -> tuple[Manifest, list[str]]:
    """What the inventory holds, and logs that it held before: somebody took their results away."""
    if not (inventory / MANIFEST).exists():
        return Manifest(), []
    manifest = read_manifest(inventory)
    left = [
        entry.name for entry in manifest.done() if not (inventory / DRIVES / entry.name).exists()
    ]
    kept = {name: entry for name, entry in manifest.logs.items() if name not in left}
    return replace(manifest, logs=kept), left


def planned_logs(
    uris: Sequence[str],
    earlier: Manifest,
    key_of: Callable[[str], str],
    inventory: Path,
    *,
    retry: bool,
    overwrite: bool,
) -> tuple[dict[str, Entry], list[tuple[str, str]]]:
    """The given logs by name with the states in which the fleet begins, and those that are copies of others.

    A log is known by its source, or by its content where it has moved.

    Raises
    ------
    OutputError
        The content of logs has changed, and their results are not to be replaced.
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
            planned[name] = _entry(name, uri, known, found, key_of, retry=retry)
            by_content[planned[name].fingerprint] = planned[name]
        if changed and not overwrite:
            some = ", ".join(changed[:3]) + (", ..." if len(changed) > 3 else "")
            raise OutputError(
                f"{len(changed)} of the logs that {inventory} holds have changed: {some}. Give them other names to "
                "add them, or replace their results with --overwrite."
            )
        standing = readers.map(lambda entry: _standing(inventory, entry, earlier), planned.values())
        return {entry.name: entry for entry in standing}, copies


def _entry(
    name: str,
    uri: str,
    known: Entry | None,
    found: tuple[str, int] | str,
    key_of: Callable[[str], str],
    *,
    retry: bool,
) -> Entry:
    """A log as the fleet begins with it: waiting, or in quarantine still, or because it cannot be read (`found`)."""
    if isinstance(found, str):
        content, size = ("", 0) if known is None else (known.fingerprint, known.bytes)
        key = key_of(content) if content else None
        status = InputError.exit_status
        return Entry(name, uri, content, size, key, QUARANTINED, status, words=found)
    entry = Entry(name, uri, *found, key_of(found[0]))
    tried = known is not None and known.state == QUARANTINED and known.attempts > 0
    if known is not None and tried and known.key == entry.key and not retry:
        return replace(known, source=uri)
    return entry


def _looked_at(uri: str) -> tuple[str, int] | str:
    try:
        return fingerprint_source(uri)
    except UnreachableError as error:
        return str(error)


def _standing(inventory: Path, entry: Entry, earlier: Manifest) -> Entry:
    """The entry as done where its result stands, else as it is."""
    folder = inventory / DRIVES / entry.name
    finish_replacement(folder)
    if not is_finished(folder, entry.key):
        return entry
    before = earlier.logs.get(entry.name)
    if before is not None and before.state == DONE and before.key == entry.key:
        return replace(before, source=entry.source)
    return replace(entry, **asdict(finished_outcome(folder, entry.attempts)))
