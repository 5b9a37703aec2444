"""The demo drive with faults written into its log, run as a user runs it, and compared with the sound one."""

import json
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from common import DEMO, run_wayside
from faulty_logs import ATTACKS, read_log, write_log

HEADS = ("fault", "exit", "images used", "rows", "of the sound log, within", "reported")


@dataclass(frozen=True)
class Outcome:
    """The result of a run: exit status, images, used images, positions against those of the sound log, words."""

    status: int
    images: int
    used: int
    rows: int
    matched: int
    worst_m: float
    said: tuple[str, ...]


def rows(only: Sequence[str], _: int, __: int) -> Iterator[tuple[list[str], bool]]:
    """A row for each fault whose name contains one of `only`; wrong: another end than with words and a status."""
    messages = read_log(DEMO)
    with tempfile.TemporaryDirectory() as folder:
        reference = Path(folder) / "reference"
        run_attack(DEMO, reference, ())
        for number, (name, (edit, options)) in enumerate(ATTACKS.items()):
            if not any(part in name for part in only):
                continue
            log, out = Path(folder) / f"demo{number}.mcap", Path(folder) / str(number)
            write_log(log, edit(messages))
            found = run_attack(log, out, options)
            if found.images:
                matched, worst = compare(out, reference)
                found = replace(found, matched=matched, worst_m=worst)
            log.unlink()
            yield _cells(name, found), found.status in (0, 3, 4)


def run_attack(log: Path, out: Path, options: Sequence[str]) -> Outcome:
    """Run one log as a user does."""
    done = run_wayside("run", log, "-o", out, *options)
    if not (out / "run.json").is_file():
        words = [line for line in done.stderr.splitlines() if line.strip()]
        return Outcome(done.returncode, 0, 0, 0, 0, float("nan"), tuple(words[-1:]))
    about = json.loads((out / "run.json").read_text())
    count, said = about["accounting"], (*about["notes"], *about["accounting"]["lost"])
    images = count["frames_read"], count["used"]
    return Outcome(done.returncode, *images, len(reported(out)), 0, float("nan"), said)


def reported(out: Path) -> list[dict[str, Any]]:
    """Rows of the signs that a run reports; those of status uncertain are for a person to look at."""
    columns = ["station_m", "lateral_m", "up_m", "status"]
    rows = pq.read_table(out / "signs.parquet", columns=columns).to_pylist()
    return [row for row in rows if row["status"] != "uncertain"]


def compare(out: Path, reference: Path) -> tuple[int, float]:
    """Signs that are also in the reference (nearest by station), and the largest distance, metres.

    Distances are along and across the path. Of all shifts along the path, as by another origin, the best is taken.
    """
    found, true = (
        np.nan_to_num(
            np.array([[r["station_m"], r["lateral_m"], r["up_m"]] for r in reported(one)], float),
            nan=1e9,  # null: no place, near none
        ).reshape(-1, 3)
        for one in (out, reference)
    )
    best: tuple[int, float] = (0, float("nan"))
    for origin in np.unique(np.round(found[:, None, 0] - true[None, :, 0], 1)):
        nearest = np.linalg.norm(found[:, None] - true[None] - [origin, 0, 0], axis=2).min(axis=0)
        near = nearest[nearest < 2.0]
        if len(near) and (len(near), -near.max()) > (best[0], -best[1] if best[0] else -np.inf):
            best = len(near), float(near.max())
    return best


def _cells(name: str, found: Outcome) -> list[str]:
    said = "; ".join(found.said).replace("|", "/").replace("\n", " ")
    said = re.sub(r"\S*/demo\d*\.mcap", "drive.mcap", said)
    place = f"{found.matched}, {found.worst_m:.2f} m" if found.matched else ""
    images = f"{found.used} of {found.images}" if found.images else "none"
    return [name, str(found.status), images, str(found.rows), place, said]
