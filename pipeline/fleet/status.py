"""How far a fleet is: counts, rate, time left, in words."""

from collections import Counter
from datetime import datetime, timedelta
from pathlib import Path

from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.fleet.folders import is_merged, is_under_way, open_inventory
from wayside.pipeline.fleet.manifest import ENDED, LOGS, MANIFEST, QUARANTINE, Manifest, State

_MOST_LISTED = 20


def describe_progress(manifest: Manifest, now: float) -> str:
    """How far a fleet is at a time, seconds since 1970, in a line; rate and time left are of its own logs, by bytes."""
    counts = Counter(entry.state for entry in manifest.logs.values())
    words = [f"{counts[State.DONE]} of {counted(len(manifest.logs), 'log')} done"]
    if counts[State.QUARANTINED]:
        words.append(f"{counts[State.QUARANTINED]} in quarantine")
    own = [entry for entry in manifest.logs.values() if entry.since >= manifest.started]
    ended = [entry for entry in own if entry.state == State.DONE]
    elapsed, worked = now - manifest.started, sum(entry.bytes for entry in ended)
    if elapsed > 0 and worked:
        words.append(f"{sum(entry.images for entry in ended) / elapsed:.1f} images/s")
        if left := sum(entry.bytes for entry in own if entry.state not in ENDED):
            words.append(f"about {describe_duration(elapsed / worked * left)} left")
    return ", ".join(words)


def format_status(inventory: Path) -> str:
    """What `wayside fleet status` prints; raises InputError where the folder is no inventory."""
    running = is_under_way(inventory)
    if running and not (inventory / MANIFEST).exists():
        return f"{inventory}: a fleet has started and is checking its logs"
    manifest = open_inventory(inventory)
    told = f"no fleet is running; the last one was active until {_clock(manifest.updated)}"
    if running:
        told = f"a fleet has been running since {_clock(manifest.started)}: {manifest.where}"
    entries = [entry for _, entry in sorted(manifest.logs.items())]
    images, rows = (sum(getattr(entry, name) for entry in entries) for name in ("images", "rows"))
    lines = [
        f"{inventory}: {told}",
        describe_progress(manifest, manifest.updated),
        f"{counted(images, 'image')}, {counted(rows, 'row')} of signs before merging",
    ]
    if lost := sum(entry.state == State.DONE and entry.status != 0 for entry in entries):
        lines.append(
            f"{counted(lost, 'log')} done with parts lost: see `accounting` in their run.json"
        )
    lines.append(f"panels: {_merging(inventory, manifest, running=running)}")
    lines += _listed("drives with a constant offset", list(manifest.vectors))
    at_work = [
        f"{e.name}: since {_clock(e.since)}, {LOGS}/{e.name}.txt"
        for e in entries
        if running and e.state == State.RUNNING
    ]
    held = [
        f"{e.name}: exit status {e.status}, attempts {e.attempts}: {e.words.partition(chr(10))[0]}"
        for e in entries
        if e.state == State.QUARANTINED
    ]
    lines += [*_listed("running", at_work), *_listed("in quarantine", held)]
    if held:
        lines.append(f"details: {QUARANTINE}/NAME/log.txt; try again with --retry")
    return "\n".join(lines)


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
    stand = is_merged(inventory)
    if stand and manifest.merged == manifest.results():
        return "merged"
    if running and all(entry.state in ENDED for entry in manifest.logs.values()):
        return "being merged now"
    if stand and manifest.merged:
        return "out of date, not merged again yet"
    return "not merged yet"


def _clock(seconds: float) -> str:
    moment = datetime.fromtimestamp(seconds)
    recent = datetime.now() - moment < timedelta(hours=20)
    return f"{moment:%H:%M:%S}" if recent else f"{moment:%Y-%m-%d %H:%M}"


def _listed(heading: str, lines: list[str]) -> list[str]:
    if not lines:
        return []
    more = [f"  ... and {len(lines) - _MOST_LISTED} more"] if len(lines) > _MOST_LISTED else []
    return [f"{heading}:", *(f"  {line}" for line in lines[:_MOST_LISTED]), *more]
