"""`fleet.json`: every log of an inventory, what it is, what became of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import version
from itertools import chain, count
from pathlib import Path

from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.files.writing import write_file
from wayside.pipeline.fleet.sources import folder_name, is_folder_name, source_name
from wayside.schemas.errors import InputError

MANIFEST, DRIVES, LOGS, QUARANTINE = "fleet.json", "drives", "logs", "quarantine"
WAITING, RUNNING, DONE, QUARANTINED = "waiting", "running", "done", "quarantined"
ENDED = (DONE, QUARANTINED)
STATES = (WAITING, RUNNING, *ENDED)


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
    state: str = WAITING
    """One of `STATES`."""
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

    def with_entries(self, entries: Iterable[Entry]) -> Manifest:
        """The same with these entries in the place of those of their names."""
        return replace(self, logs={**self.logs, **{entry.name: entry for entry in entries}})

    def done(self) -> list[Entry]:
        """Logs whose results are part of the inventory, by name."""
        return sorted(
            (entry for entry in self.logs.values() if entry.state == DONE),
            key=lambda entry: entry.name,
        )

    def results(self) -> str:
        """Digest that says which results are part of the inventory now."""
        text = json.dumps([(entry.name, entry.key) for entry in self.done()])
        return hashlib.sha256(text.encode()).hexdigest()


def read_manifest(inventory: Path) -> Manifest:
    """Content of `fleet.json`.

    Raises
    ------
    InputError
        There is none, or it is damaged.
    """
    file = inventory / MANIFEST
    try:
        content = parse_json(read_input_text(file))
        known = {each.name for each in fields(Entry)}
        logs = {
            name: Entry(**{k: v for k, v in entry.items() if k in known})
            for name, entry in content["logs"].items()
        }
        if any(e.state not in STATES or name != e.name for name, e in logs.items()):
            raise ValueError("a log of an unknown state or another name")
        if strays := [name for name in logs if not is_folder_name(name)]:
            raise ValueError(f"the log {strays[0]!r} has no name of a folder in the inventory")
        told = {k: content[k] for k in ("started", "updated", "where", "merged")}
        vectors = [str(line) for line in content.get("vectors", ())]
        return Manifest(logs, **told, merged_by=content.get("merged_by", ""), vectors=vectors)
    except FileNotFoundError as error:
        raise InputError(
            f"{inventory} is no inventory: it has no {MANIFEST}; `wayside fleet LOGS -o {inventory}` makes one"
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
    """A name for a new log: its stem, else with that of its folder before it, else with a number behind it.

    What no file system, terminal or shell takes for anything but a name is kept; a digest ends what is too long.

    taken: names that are in use, `str.casefold` of each, as some file systems do not tell them apart otherwise.
    """
    stem, parent = source_name(uri)
    first = [stem, f"{parent}_{stem}"] if parent else [stem]
    names = map(folder_name, chain(first, (f"{stem}_{number}" for number in count(2))))
    return next(name for name in names if name.casefold() not in taken)
