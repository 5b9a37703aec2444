"""Fills disks of many sizes with the files of a run and of other commands, and says what each leaves.

    sudo .venv/bin/python benchmarks/reliability_disk.py recordings/demo.mcap [--sizes 17] [--room 4]

Each size is a tmpfs of its own (mounting one needs root) that holds an old result; a run of the same log with other
settings is then written over it. Wanted: exit status 5 with words and without a traceback, the old result whole and no
scratch file left; or exit status 0 and the new result. Prints a table and ends with status 1 where anything else
happened.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from reliability_kills import OLD, state, tables_of

NEW = ("--until", "2.5s", "--observations", "all")
RECORDED = (*NEW, "--view", "file")
PAGE_KB = 4


def main() -> int:
    """Fill, judge, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--sizes", type=int, default=17)
    parser.add_argument(
        "--room",
        type=float,
        default=4.0,
        help="free space of the largest disk over the size of the new result",
    )
    parser.add_argument("--command", default=str(Path(sys.executable).with_name("wayside")))
    args = parser.parse_args()
    left: Counter[tuple[str, ...]] = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        digests = {}
        for name, options in (("old", OLD), ("new", NEW), ("recorded", RECORDED)):
            _run(args, work / name, options)
            digests[name] = tables_of(work / name)
        digests.pop("recorded")
        rooms = {"tables": work / "new", "tables and recording": work / "recorded"}
        for trial in range(args.sizes):
            for kind, options in (("tables", NEW), ("tables and recording", RECORDED)):
                free = (
                    round(trial * args.room * size_kb(rooms[kind]) / (args.sizes - 1) / PAGE_KB)
                    * PAGE_KB
                )
                with disk(work / "disk", size_kb(work / "old") + free) as folder:
                    out = folder / "out"
                    subprocess.run(["cp", "-r", str(work / "old"), str(out)], check=True)
                    done = _run(args, out, options)
                    names = {path.name for path in out.iterdir()}
                    scratch_files = sorted(names - {*digests["old"], "run.json", "drive.rrd"})
                    left[
                        kind,
                        str(done.returncode),
                        "traceback" if "Traceback" in done.stderr else "words",
                        state(out, digests, recorded=kind != "tables"),
                        ", ".join(scratch_files) or "none",
                    ] += 1
    print("| written | exit status | stderr | result | scratch files | disks |")
    print("| --- | ---: | --- | --- | --- | ---: |")
    for found, count in sorted(left.items()):
        print(f"| {' | '.join(found)} | {count} |")
    good = {("5", "words", "old", "none"), ("0", "words", "new", "none")}
    recording_left_out = ("5", "words", "new tables without a recording", "none")
    return 0 if all(found[1:] in {*good, recording_left_out} for found in left) else 1


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


def _run(
    args: argparse.Namespace, out: Path, options: tuple[str, ...]
) -> subprocess.CompletedProcess[str]:
    line = [args.command, "run", str(args.log), "-o", str(out), *options]
    return subprocess.run(line, capture_output=True, text=True, check=False)


if __name__ == "__main__":
    sys.exit(main())
