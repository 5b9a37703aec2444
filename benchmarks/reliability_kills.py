"""Kills runs at many moments and says what they leave: the old result, the new one, or something else.

    .venv/bin/python benchmarks/reliability_kills.py recordings/demo.mcap [--kills 40] [--command .venv/bin/wayside]

Every trial starts from a whole old result and runs the same log with other settings into its folder. Half of the kills
(SIGKILL) are spread evenly over the duration of an undisturbed run; the other half follow the moment when the first
file of the result changes, after 0 to 30 ms. The folder is then judged twice: as the files lie there, and
as `wayside` reads it. With `--resume` the run keeps a journal; the kills are spread over its growth, and the same
command is given once more after each; what it leaves must be the new result, with the same bytes.

A result is whole when all tables have the digests that its `run.json` states and belong to the same run. Prints a
table and ends with status 1 where a trial left neither the old result nor the new one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

TABLES = ("signs.parquet", "observations.parquet", "frames.parquet")
OLD = ("--until", "1.5s")
NEW = ("--until", "2.5s", "--view", "file")
LONGEST_DELAY_S = 0.03
JOURNAL = ".wayside-journal"


def main() -> int:
    """Kill, judge, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--command", default=str(Path(sys.executable).with_name("wayside")))
    args = parser.parse_args()
    new = (*NEW[:2], "--resume") if args.resume else NEW
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        digests, seconds, grown = {}, 0.0, 0
        for name, options in (("old", OLD), ("new", new)):
            start = time.monotonic()
            grown = watched(_line(args, work / name, options), work / name / JOURNAL)
            seconds = time.monotonic() - start
            digests[name] = tables_of(work / name)
        left: Counter[tuple[str, str]] = Counter()
        for trial in range(args.kills):
            out = work / f"trial-{trial}"
            shutil.copytree(work / "old", out)
            fraction = (trial // 2) / max(args.kills // 2 - 1, 1)
            if args.resume:
                share = trial / args.kills * grown
                watched(_line(args, out, new), out / JOURNAL, until=share)
            else:
                killed(_line(args, out, new), out, fraction, seconds, late=bool(trial % 2))
            lying = state(out, digests, recorded=not args.resume)
            reading = [args.command, "evidence", str(out), "-o", str(work / "sheets")]
            again = _line(args, out, new) if args.resume else reading
            subprocess.run(again, capture_output=True, check=False)
            left[lying, state(out, digests, recorded=not args.resume)] += 1
            shutil.rmtree(out)
            print(f"{trial + 1} of {args.kills}: {dict(left)}", file=sys.stderr, flush=True)
    then = "after the same command once more" if args.resume else "as wayside reads it"
    print(f"| as the files lie there | {then} | kills |")
    print("| --- | --- | ---: |")
    for (lying, read), count in sorted(left.items()):
        print(f"| {lying} | {read} | {count} |")
    good = ("new",) if args.resume else ("old", "new")
    return 0 if all(read in good for _, read in left) else 1


def killed(line: list[str], out: Path, fraction: float, seconds: float, *, late: bool) -> None:
    """Start a run and kill it after a fraction of its duration, or after the first table or `run.json` changes."""
    before = signature(out)
    running = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    if late:
        while running.poll() is None and signature(out) == before:
            pass
        time.sleep(fraction * LONGEST_DELAY_S)
    else:
        time.sleep(fraction * seconds)
    running.send_signal(signal.SIGKILL)
    running.wait()


def watched(line: list[str], journal: Path, until: float = float("inf")) -> int:
    """Run, and kill the run when its journal has reached a size; the largest size that was seen, bytes."""
    largest = 0
    running = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while running.poll() is None:
        if journal.exists():
            with suppress(FileNotFoundError):
                largest = max(largest, journal.stat().st_size)
            if largest >= until:
                running.kill()
                running.wait()
                return largest
        time.sleep(0.001)
    if running.returncode not in (0, -signal.SIGKILL):
        raise RuntimeError(f"{' '.join(line)} ended with status {running.returncode}")
    return largest


def signature(out: Path) -> list[object]:
    """What changes when a table or `run.json` is replaced or goes."""
    found: list[object] = []
    for name in (*TABLES, "run.json"):
        try:
            found.append((out / name).stat().st_ino)
        except OSError:
            found.append(None)
    return found


def tables_of(out: Path) -> dict[str, str]:
    """Digest of each table."""
    return {name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in TABLES}


def state(out: Path, digests: dict[str, dict[str, str]], *, recorded: bool = True) -> str:
    """`old`, `new`, or in words what else stands there; `recorded`: the new one comes with a recording."""
    absent = [name for name in (*TABLES, "run.json") if not (out / name).is_file()]
    if absent:
        return f"without {', '.join(absent)}"
    found = tables_of(out)
    stated = json.loads((out / "run.json").read_text())["files"]
    names = [name for name, known in digests.items() if known == found]
    if not names:
        return "tables of both runs"
    if any(stated[name]["sha256"] != found[name] for name in TABLES):
        return f"{names[0]} tables beside the other run.json"
    has_recording = (out / "drive.rrd").exists()
    if has_recording != (recorded and names[0] == "new"):
        return f"{names[0]} tables {'beside' if has_recording else 'without'} a recording"
    return names[0]


def _line(args: argparse.Namespace, out: Path, options: tuple[str, ...]) -> list[str]:
    return [args.command, "run", str(args.log), "-o", str(out), *options]


if __name__ == "__main__":
    sys.exit(main())
