"""Run the demo drive with faults of clocks, order and positions written into it, and list what comes of each.

    .venv/bin/python benchmarks/reliability_clocks.py [--only NAME ...] [--page]

Every log is written by the stock MCAP writer from recordings/demo.mcap; every run is a process of its own, as a user
starts it. With --page the table in benchmarks/reliability.md, section "Clocks, order, outliers", is written anew.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from logged_messages import read_log, write_log
from reliability_attacks import ATTACKS

ROOT = Path(__file__).resolve().parents[1]
DEMO = ROOT / "recordings" / "demo.mcap"
PAGE = ROOT / "benchmarks" / "reliability.md"
SECTION = "## Clocks, order, outliers"
WORDS = """`.venv/bin/python benchmarks/reliability_clocks.py --page` writes each fault into the demo drive (24 images,
10 rows) with the stock MCAP writer and runs `wayside run` on it; `--only NAME` measures single rows anew. `of 10,
within`: rows of the sound log that are found again, and the largest distance from their place along, beside and above
the path, one common shift along the path removed. `said`: notes, and what was lost, or the error.
[docs/input.md](../docs/input.md) states the rules.

Before, logs were put in order by rules, and pixels of two images were compared for their order. What was used and is
not any more: a log whose clocks were all set back, or whose first image or messages stand a year off, is refused with
the reason (7 rows); poses behind a move of their origin are left out and counted. Exchanged pixels are not told: with
poses the rows stay within 0.16 m, with a spacing alone 7 of 10 do.
"""


@dataclass(frozen=True)
class Outcome:
    """What a run came to: exit status, images and those used, positions against those of the sound log, words."""

    status: int
    images: int
    used: int
    rows: int
    matched: int
    worst_m: float
    said: tuple[str, ...]


def run_attack(log: Path, out: Path, options: Sequence[str]) -> Outcome:
    """Run one log as a user does."""
    command = [sys.executable, "-c", "from wayside.pipeline.cli import main; main()", "run"]
    done = subprocess.run(
        [*command, str(log), "-o", str(out), *options],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    if not (out / "run.json").is_file():
        words = [line for line in done.stderr.splitlines() if line.strip()]
        return Outcome(done.returncode, 0, 0, 0, 0, float("nan"), tuple(words[-1:]))
    about = json.loads((out / "run.json").read_text())
    count = about["accounting"]
    rows = len(reported(out, ["status"]))
    said = (*about["notes"], *count["lost"])
    return Outcome(
        done.returncode, count["frames_read"], count["used"], rows, 0, float("nan"), said
    )


def reported(out: Path, columns: list[str]) -> list[dict[str, Any]]:
    """Rows of the signs that a run reports; those of status uncertain are for a person to look at."""
    rows = pq.read_table(out / "signs.parquet", columns=columns).to_pylist()
    return [row for row in rows if row["status"] != "uncertain"]


def compare(out: Path, reference: Path) -> tuple[int, float]:
    """Signs that are also in the reference (nearest by station), and the largest distance, metres.

    Distances are along and beside the path, relative to the sign before, so that another origin is no error.
    """
    columns = ["station_m", "lateral_m", "up_m", "status"]
    a, b = (reported(folder, columns) for folder in (out, reference))
    if not a or not b:
        return 0, float("nan")

    def places(rows: list[dict[str, Any]]) -> np.ndarray:
        given = [[r["station_m"], r["lateral_m"], r["up_m"]] for r in rows]
        return np.nan_to_num(np.array(given, np.float64), nan=1e9)  # null: no place, near none

    found, true = places(a), places(b)
    best: tuple[int, float] = (0, float("nan"))
    for origin in np.unique(np.round(found[:, None, 0] - true[None, :, 0], 1)):
        apart = np.linalg.norm(found[:, None] - true[None] - [origin, 0, 0], axis=2)
        nearest = apart.min(axis=0)
        near = nearest < 2.0
        score = (int(near.sum()), -float(nearest[near].max()) if near.any() else 0.0)
        if score > (best[0], -best[1] if best[0] else -np.inf):
            best = (score[0], -score[1])
    return best


def main() -> int:
    """Run the attacks and print, or write, the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", help="names of attacks; default: all")
    parser.add_argument("--page", action="store_true", help="write the table into the page")
    chosen = parser.parse_args()
    names = chosen.only or list(ATTACKS)
    messages = read_log(DEMO)
    lines = [
        "| attack | exit | images used | rows | of 10, within | said |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    with tempfile.TemporaryDirectory() as folder:
        reference = Path(folder) / "reference"
        run_attack(DEMO, reference, ())
        for number, name in enumerate(names):
            edit, options = ATTACKS[name]
            log, out = Path(folder) / f"demo{number}.mcap", Path(folder) / str(number)
            write_log(log, edit(messages))
            found = run_attack(log, out, options)
            if found.images:
                matched, worst = compare(out, reference)
                found = replace(found, matched=matched, worst_m=worst)
            log.unlink()
            lines.append(_line(name, found))
            print(lines[-1], flush=True)
    if chosen.page:
        _write_section(lines)
    return 0


def _line(name: str, found: Outcome) -> str:
    said = "; ".join(found.said).replace("|", "/").replace("\n", " ")
    said = re.sub(r"\S*/demo\d*\.mcap", "drive.mcap", said)
    place = f"{found.matched}, {found.worst_m:.2f} m" if found.matched else ""
    images = f"{found.used} of {found.images}" if found.images else "none"
    return f"| {name} | {found.status} | {images} | {found.rows} | {place} | {said} |"


def _write_section(lines: list[str]) -> None:
    """Put rows into the table of their section of the page, each in place of the one of the same attack."""
    text = PAGE.read_text() if PAGE.is_file() else "# Reliability\n"
    head, _, rest = text.partition(SECTION)
    own, mark, others = rest.partition("\n## ")
    rows = {line.split(" | ")[0]: line for line in own.splitlines() if line.startswith("| ")}
    rows |= {line.split(" | ")[0]: line for line in lines}
    known = ["| attack", "| ---", *(f"| {name}" for name in ATTACKS)]
    table = "\n".join(rows[name] for name in known if name in rows)
    PAGE.write_text(f"{head.rstrip()}\n\n{SECTION}\n\n{WORDS}\n{table}\n{mark}{others}")


if __name__ == "__main__":
    sys.exit(main())
