"""Runs that are killed, and runs on full disks: the old result, the new one, or something else.

A result is whole when all tables have the digests that its `run.json` states and belong to the same run.
"""

import hashlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

from attempts import limit_memory
from common import DEMO, processor_seconds, run_wayside
from faulty_logs import read_log, scaled, write_log

from wayside.pipeline.cli import app, main

KILL_HEADS = ("as the files lie there", "as wayside leaves them", "kills")
DISK_HEADS = ("written", "exit status", "stderr", "result", "scratch files", "disks")
TABLES = ("signs.parquet", "observations.parquet", "frames.parquet")
OLD, NEW = ("--until", "0.9s"), ("--until", "1.2s", "--view", "file")
RESUMED = ("--until", "1.2s", "--resume")
TABLES_ONLY = ("--until", "1.2s", "--observations", "all")
LONGEST_DELAY_S = 0.03
"""Between the first change of a result and a kill that follows it."""
SCALE = 0.5
"""Size of the images of the runs that are killed, so that a kill costs less."""
ROOM, PAGE_KB = 1.25, 4
"""Free space of the largest disk over the size of the new result; size of a page of a tmpfs."""


def kill_rows(
    new: tuple[str, ...], good: tuple[str, ...], _: Sequence[str], count: int, __: int
) -> Iterator[tuple[list[str], bool]]:
    """What kills of a run leave: as the files lie there, and behind another command, of which some are `good`.

    It opens the result; where the old one is not good, it is the same run again, which must give the new one.
    """
    left: Counter[tuple[str, str]] = Counter()
    recorded = "--view" in new
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        log, digests = work / "drive.mcap", {}
        write_log(log, scaled(read_log(DEMO), SCALE))
        with redirect_stdout(io.StringIO()):  # imports and compiles
            app(["run", str(log), "-o", str(work / "warm"), *new], standalone_mode=False)
        for name, options in (("old", OLD), ("new", new)):
            before = processor_seconds()
            waited(forked(("run", log, "-o", work / name, *options)))
            whole_s = processor_seconds() - before
            digests[name] = tables_of(work / name)
        for trial in range(count):
            out = work / f"trial-{trial}"
            shutil.copytree(work / "old", out)
            again = ("run", log, "-o", out, *new)
            running = forked(again)
            share = trial // 2 / max(count // 2 - 1, 1)
            if trial % 2:
                wait_for_change(running, out, share * LONGEST_DELAY_S)
            else:
                wait_for_work(running, share * whole_s)
            os.kill(running, signal.SIGKILL)
            os.waitpid(running, 0)
            lying = state(out, digests, recorded=recorded)
            sheets = ("evidence", out, "-o", work / f"sheets-{trial}")
            waited(forked(sheets if "old" in good else again))
            left[lying, state(out, digests, recorded=recorded)] += 1
            shutil.rmtree(out)
            print(f"{trial + 1} of {count}: {dict(left)}", file=sys.stderr, flush=True)
    for (lying, read), kills in sorted(left.items()):
        yield [lying, read, str(kills)], read in good


def disk_rows(_: Sequence[str], count: int, __: int) -> Iterator[tuple[list[str], bool]]:
    """What full disks leave: words and the old result, or the new one, and no scratch files."""
    left: Counter[tuple[str, ...]] = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        work, digests = Path(scratch), {}
        ways = {"tables": TABLES_ONLY, "tables and recording": (*TABLES_ONLY, "--view", "file")}
        for name, options in ({"old": OLD} | ways).items():
            run_wayside("run", DEMO, "-o", work / name, *options, check=True)
            digests[name] = tables_of(work / name)
        digests["new"] = digests.pop("tables")
        digests.pop("tables and recording")
        for trial in range(count):
            for kind, options in ways.items():
                room_kb = round(ROOM * trial / max(count - 1, 1) * size_kb(work / kind))
                with disk(work / "disk", size_kb(work / "old") + room_kb // 4 * 4) as folder:
                    out = folder / "out"
                    shutil.copytree(work / "old", out)
                    done = run_wayside("run", DEMO, "-o", out, *options)
                    names = {path.name for path in out.iterdir()}
                    scratch_files = sorted(names - {*TABLES, "run.json", "drive.rrd"})
                    left[
                        kind,
                        str(done.returncode),
                        "traceback" if "Traceback" in done.stderr else "words",
                        state(out, digests, recorded="--view" in options),
                        ", ".join(scratch_files) or "none",
                    ] += 1
    good = {("5", "words", "old", "none"), ("0", "words", "new", "none")}
    for found, disks in sorted(left.items()):
        yield [*found, str(disks)], found[1:] in good


def size_kb(folder: Path) -> int:
    """Room that the files of a folder, and the folder, take on a tmpfs."""
    return sum(-(-path.stat().st_size // 4096) * PAGE_KB for path in folder.iterdir()) + 2 * PAGE_KB


@contextmanager
def disk(folder: Path, size_kb: int) -> Iterator[Path]:
    """A file system of that size."""
    folder.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size_kb}k", "tmpfs", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def forked(words: Sequence[object], said: str = os.devnull, more_bytes: int | None = None) -> int:
    """Give `wayside` these words in a process that has everything imported; its number.

    `said`: file of what it says on stderr; `more_bytes`: memory that it may take beyond what is in use.
    """
    if child := os.fork():
        return child
    status = 99
    try:
        os.setsid()
        for stream, name in enumerate((os.devnull, os.devnull, said)):
            os.dup2(os.open(name, os.O_RDWR | os.O_CREAT), stream)
        if more_bytes is not None:
            limit_memory(more_bytes)
        sys.argv[1:] = map(str, words)
        main()
    except SystemExit as end:
        status = int(end.code or 0)
    except BaseException:
        os.write(2, traceback.format_exc().encode("utf-8", "backslashreplace"))
    finally:
        os._exit(status)


def waited(running: int) -> None:
    """Wait for a process to end; an error if it did not end well."""
    _, status = os.waitpid(running, 0)
    if status:
        raise RuntimeError(f"wayside ended with wait status {status}")


def wait_for_work(running: int, seconds: float) -> None:
    """Return when a process has used so much processor time, or has ended."""
    while not has_ended(running) and spent(running)[1] < seconds:
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


def spent(running: int) -> tuple[str, float]:
    """State of a process as the system calls it, and its processor time so far, seconds."""
    fields = Path(f"/proc/{running}/stat").read_text().rpartition(")")[2].split()
    return fields[0], (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def signature(out: Path) -> list[int | None]:
    """What changes when a table or `run.json` is replaced or goes."""
    paths = [out / name for name in (*TABLES, "run.json")]
    return [path.stat().st_ino if path.exists() else None for path in paths]


def tables_of(out: Path) -> dict[str, str]:
    """Digest of each table."""
    return {name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in TABLES}


def state(out: Path, digests: dict[str, dict[str, str]], *, recorded: bool) -> str:
    """`old`, `new`, or in words what else was left; `recorded`: the new one comes with a recording."""
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
