"""Kills runs at many moments and says what they leave: the old result, the new one, or something else.

    .venv/bin/python benchmarks/reliability_kills.py recordings/demo.mcap [--kills 200] [--resume] [--scale 0.5]

Every trial starts from a whole old result and runs the same log with other settings into its folder. Half of the kills
(SIGKILL) are spread evenly over the processor time of an undisturbed run; the other half follow the moment when the
first file of the result changes, after 0 to 30 ms. The folder is then judged twice: as the files lie there, and
as `wayside` reads it. With `--resume` the run keeps a journal; three of four kills are spread over the processor time,
and the same command is given once more after each; what it leaves must be the new result, with the same bytes.

A result is whole when all tables have the digests that its `run.json` states and belong to the same run. Prints a
table and ends with status 1 where a trial left neither the old result nor the new one. Runs are forked from a process
that has everything imported and compiled, so that a trial costs what its images cost.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from logged_messages import read_log, write_log
from reliability_attacks import scaled

from wayside.pipeline import run
from wayside.pipeline.cli import app

TABLES = ("signs.parquet", "observations.parquet", "frames.parquet")
OLD = ("--until", "0.9s")
NEW = ("--view", "file")
LONGEST_DELAY_S = 0.03
AFTER_LAST = ("georeference", "focal length", "signs", "route", "codes")
"""Stages after the last frame, which a run that goes on does for the first time."""
LATE_OF = {False: 2, True: 4}
"""Every so many-th kill follows the first change of a file; by whether runs are resumed."""


def main() -> int:
    """Kill, judge, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--scale", type=float, default=1.0, help="size of the images")
    parser.add_argument("--until", default="1.2s", help="part of the drive that is run")
    parser.add_argument("--network", action="store_true", help="with the detection network")
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), help="K N: every N-th, from K")
    args = parser.parse_args()
    new = ("--until", args.until, *((*NEW[:2], "--resume") if args.resume else NEW))
    if args.network:
        new = tuple(word for word in new if word not in NEW[:2])
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        log, digests = work / "drive.mcap", {}
        write_log(log, scaled(read_log(args.log), args.scale))
        warm = ["run", str(log), "-o", str(work / "warm"), "--until", args.until]
        app([*warm, *([] if args.network else NEW[:2])], standalone_mode=False)
        remove = run.remove_journal
        for name, options in (("old", OLD), ("new", new)):
            run.remove_journal = lambda folder: None  # what it would repeat is measured
            spent_s = whole_run(log, work / name, options)
            digests[name] = tables_of(work / name)
        run.remove_journal = remove
        if args.resume:
            print(repeated(log, work / "new", new, spent_s))
        left: Counter[tuple[str, str]] = Counter()
        again_s, replayed = [], []
        every = LATE_OF[args.resume]
        for trial in range(args.part[0], args.kills, args.part[1]):
            out = work / f"trial-{trial}"
            shutil.copytree(work / "old", out)
            late = trial % every == every - 1
            share = (trial // every * every) / max(args.kills - every, 1)
            running = forked(["run", str(log), "-o", str(out), *new])
            if late:
                wait_for_change(running, out, share * LONGEST_DELAY_S)
            else:
                wait_for_work(running, share * spent_s)
            os.kill(running, signal.SIGKILL)
            os.waitpid(running, 0)
            lying = state(out, digests, recorded=not args.resume)
            if args.resume:
                again_s.append(whole_run(log, out, new))
                times = json.loads((out / "run.json").read_text())["times"]
                replayed.append(times["replayed_frames"] or 0)
            else:
                os.waitpid(forked(["evidence", str(out), "-o", str(work / "sheets")]), 0)
            left[lying, state(out, digests, recorded=not args.resume)] += 1
            shutil.rmtree(out)
            print(f"{trial + 1} of {args.kills}: {dict(left)}", file=sys.stderr, flush=True)
    then = "after the same command once more" if args.resume else "as wayside reads it"
    print(f"| as the files lie there | {then} | kills |")
    print("| --- | --- | ---: |")
    for (lying, read), count in sorted(left.items()):
        print(f"| {lying} | {read} | {count} |")
    if args.resume:
        counts = np.array(replayed)
        print("processor time of the command once more, by")
        for count in np.unique(counts):
            spent = np.array(again_s)[counts == count]
            print(f"images from the journal: {count}: {np.median(spent):.2f} s, {len(spent)} kills")
    good = ("new",) if args.resume else ("old", "new")
    return 0 if all(read in good for _, read in left) else 1


def repeated(log: Path, out: Path, options: tuple[str, ...], spent_s: float) -> str:
    """What a run costs that finds all its images in the journal of the run before, in words."""
    before_s = image_stages_s(out)
    again_s = whole_run(log, out, options)
    return (
        f"processor time of an undisturbed run {spent_s:.2f} s, {before_s:.2f} s in stages of images; of one that "
        f"finds all images in the journal {again_s:.2f} s, {image_stages_s(out):.2f} s in these stages"
    )


def image_stages_s(out: Path) -> float:
    """Processor time of a run in the stages before the last frame, seconds: what a run that is ended has spent."""
    stages = json.loads((out / "run.json").read_text())["times"]["cpu_s_by_stage"]
    return float(sum(seconds for name, seconds in stages.items() if name not in AFTER_LAST))


def forked(words: list[str]) -> int:
    """Give `wayside` these words in a process of its own, silent; its number."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        status = app(words, standalone_mode=False) or 0
    except SystemExit as end:
        status = int(end.code or 0)
    finally:
        os._exit(status)


def whole_run(log: Path, out: Path, options: tuple[str, ...]) -> float:
    """Run to the end; seconds of processor time."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _, status = os.waitpid(forked(["run", str(log), "-o", str(out), *options]), 0)
    if status:
        raise RuntimeError(f"run {log} {' '.join(options)} ended with wait status {status}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def wait_for_work(running: int, seconds: float) -> None:
    """Return when a process has used so much processor time, or has ended."""
    while not has_ended(running) and spent(running) < seconds:
        time.sleep(0.002)


def wait_for_change(running: int, out: Path, delay_s: float) -> None:
    """Return a moment after the first table or `run.json` has changed, or when the process has ended."""
    before = signature(out)
    while not has_ended(running) and signature(out) == before:
        time.sleep(0.0005)
    time.sleep(delay_s)


def has_ended(running: int) -> bool:
    """Whether a child has ended; it can still be killed and waited for."""
    return os.waitid(os.P_PID, running, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def spent(running: int) -> float:
    """Processor time of a process so far, seconds."""
    fields = Path(f"/proc/{running}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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


if __name__ == "__main__":
    sys.exit(main())
