"""How far a fleet is: counts, rate, time left, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from wayside.pipeline.files.writing import give_back, not_written, take_lock
from wayside.pipeline.fleet.folders import LOCK, open_inventory
from wayside.pipeline.fleet.manifest import (
    DONE,
    ENDED,
    LOGS,
    MANIFEST,
    QUARANTINE,
    QUARANTINED,
    RUNNING,
    STATES,
    Manifest,
)
from wayside.pipeline.fleet.merging import MERGED
from wayside.schemas.errors import OutputError

_MOST_LISTED = 20


@dataclass(frozen=True, slots=True)
class Figures:
    """How far a fleet is.

    Attributes
    ----------
    counts
        Logs by state.
    images_per_s, left_s
        Rate of this fleet, and the time it needs for the rest: by bytes, at the rate so far. None before the first log
        is done.
    """

    counts: dict[str, int]
    images_per_s: float | None
    left_s: float | None

    def __str__(self) -> str:
        """One line."""
        total, done = sum(self.counts.values()), self.counts[DONE]
        words = [f"{done} of {total} logs done"]
        if self.counts[QUARANTINED]:
            words.append(f"{self.counts[QUARANTINED]} in quarantine")
        if self.images_per_s is not None:
            words.append(f"{self.images_per_s:.1f} images/s")
        if self.left_s:
            words.append(f"about {describe_duration(self.left_s)} left")
        return ", ".join(words)


def figures_of(manifest: Manifest, now: float) -> Figures:
    """Figures of a fleet at a time, seconds since 1970; rate and time are of its own logs."""
    counts = Counter(entry.state for entry in manifest.logs.values())
    own = [entry for entry in manifest.logs.values() if entry.since >= manifest.started]
    ended = [entry for entry in own if entry.state == DONE]
    remaining = [entry for entry in own if entry.state not in ENDED]
    elapsed, worked = now - manifest.started, sum(entry.bytes for entry in ended)
    by_state = {state: counts[state] for state in STATES}
    if elapsed <= 0 or not worked:
        return Figures(by_state, None, None)
    left = elapsed / worked * sum(entry.bytes for entry in remaining)
    return Figures(by_state, sum(entry.images for entry in ended) / elapsed, left)


def format_status(inventory: Path) -> str:
    """What `wayside fleet status` prints.

    Raises
    ------
    InputError
        The folder is no inventory.
    """
    running = is_under_way(inventory)
    if running and not (inventory / MANIFEST).exists():
        return f"{inventory}: a fleet has begun and looks at its logs"
    manifest = open_inventory(inventory)
    figures = figures_of(manifest, manifest.updated)
    told = f"a fleet is under way since {_clock(manifest.started)}: {manifest.where}"
    ended = f"no fleet is under way; the last one ended by {_clock(manifest.updated)}"
    entries = sorted(manifest.logs.values(), key=lambda entry: entry.name)
    lines = [f"{inventory}: {told if running else ended}", str(figures)]
    images, rows = (sum(getattr(entry, name) for entry in entries) for name in ("images", "rows"))
    lines.append(f"{images} images, {rows} rows of signs before merging")
    lost = sum(entry.state == DONE and entry.status != 0 for entry in entries)
    if lost:
        lines.append(f"{lost} logs done with parts lost: see `accounting` in their run.json")
    lines.append(f"panels: {_merging(inventory, manifest, running=running)}")
    lines += _listed("drives off by a vector", list(manifest.vectors))
    at_work = [entry for entry in entries if entry.state == RUNNING] if running else []
    lines += _listed(
        "running", [f"{e.name}: since {_clock(e.since)}, {LOGS}/{e.name}.txt" for e in at_work]
    )
    held = [entry for entry in entries if entry.state == QUARANTINED]
    lines += _listed(
        "in quarantine",
        [
            f"{e.name}: exit status {e.status}, attempts {e.attempts}: {e.words.splitlines()[0] if e.words else ''}"
            for e in held
        ],
    )
    if held:
        lines.append(f"what was tried: {QUARANTINE}/NAME/log.txt; once more: --retry")
    return "\n".join(lines)


@contextmanager
def locked_inventory(inventory: Path) -> Iterator[None]:
    """One fleet at a time in a block; the folder is made where it is missing.

    Raises
    ------
    OutputError
        Another fleet writes to it, or it cannot be written.
    """
    try:
        inventory.mkdir(parents=True, exist_ok=True)
        lock = take_lock(inventory / LOCK)
    except OSError as error:
        raise not_written(inventory, error, "the inventory") from error
    if lock is None:
        raise OutputError(
            f"{inventory}: another fleet is writing an inventory here. Wait until it is done (`wayside fleet status "
            f"{inventory}`), or choose another folder with -o."
        )
    try:
        yield
    finally:
        give_back(lock)


def is_under_way(inventory: Path) -> bool:
    """Whether a fleet writes to an inventory now."""
    if not (inventory / LOCK).exists():
        return False
    try:
        lock = take_lock(inventory / LOCK)
    except OSError:  # not ours to write: nobody here can tell
        return False
    if lock is not None:
        lock.release()
    return lock is None


def describe_duration(seconds: float) -> str:
    """A time for a person: 40 s, 12 min, 3 h 20 min, 2 days 4 h."""
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{max(round(seconds), 1)} s"
    if minutes < 90:
        return f"{minutes} min"
    if minutes < 48 * 60:
        return f"{minutes // 60} h {minutes % 60} min"
    hours = round(seconds / 3600)
    return f"{hours // 24} days {hours % 24} h"


def _merging(inventory: Path, manifest: Manifest, *, running: bool) -> str:
    """Whether the merged tables are of the results as they are now, in words."""
    stand = all((inventory / name).is_dir() for name in MERGED)
    if stand and manifest.merged == manifest.results():
        return "merged"
    if running and all(entry.state in ENDED for entry in manifest.logs.values()):
        return "being merged now"
    return (
        "of earlier results, to be merged anew" if stand and manifest.merged else "not merged yet"
    )


def _clock(seconds: float) -> str:
    moment = datetime.fromtimestamp(seconds)
    recent = datetime.now() - moment < timedelta(hours=20)
    return f"{moment:%H:%M:%S}" if recent else f"{moment:%Y-%m-%d %H:%M}"


def _listed(heading: str, lines: list[str]) -> list[str]:
    if not lines:
        return []
    more = [f"  ... and {len(lines) - _MOST_LISTED} more"] if len(lines) > _MOST_LISTED else []
    return [f"{heading}:", *(f"  {line}" for line in lines[:_MOST_LISTED]), *more]
