"""Runs a long log and watches the memory of the process from outside.

    .venv/bin/python benchmarks/reliability_soak.py recordings/demo.mcap [--times 80] [--scale 0.5] [-- OPTION ...]

The long log is the short one played over and over, its images and calibration, times moved on. Prints the resident
memory, threads and open files over the run; what is grown is the slope of a line through the samples of the last four
fifths, over that time. The first and the last turn must have the same number of signs. Ends with status 1 where a
line through the samples rises by more than `--growth` of its start.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from costs import play
from logged_messages import read_log, write_log
from reliability_attacks import scaled

SAMPLE_S = 2.0
ROWS = 10
ENTRY = "from wayside.pipeline.cli import main; main()"


def main() -> int:
    """Run, watch, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--times", type=int, default=80)
    parser.add_argument("--scale", type=float, default=1.0, help="size of the images")
    parser.add_argument("--spacing", default="26.4ft")
    parser.add_argument("--growth", type=float, default=0.05)
    parser.add_argument("options", nargs="*", help="more options of `wayside run`, after --")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        short, long, out = (Path(scratch) / name for name in ("short.mcap", "long.mcap", "out"))
        write_log(short, scaled(read_log(args.log), args.scale))
        play(short, long, args.times)
        command = [sys.executable, "-c", ENTRY, "run", str(long), "-o", str(out)]
        command += ["--spacing", args.spacing, "--set", "read.thin_m=0", *args.options]
        running = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        samples = watched(running, long)
        if running.returncode not in (0, 4):
            print(f"the run ended with status {running.returncode}", file=sys.stderr)
            return 1
        about = json.loads((out / "run.json").read_text())
        stations = np.array(pq.read_table(out / "signs.parquet")["station_m"].to_pylist())
        length = max(pq.read_table(out / "frames.parquet")["station_m"].drop_null().to_pylist())
    turn = length / args.times
    signs = [
        int(((stations >= k * turn) & (stations < (k + 1) * turn)).sum())
        for k in (1, -2 % args.times)
    ]
    images, wall_s = about["accounting"]["frames_read"], about["times"]["wall_s"]
    print(
        f"{images} images in {wall_s / 60:.1f} min; signs in the second turn {signs[0]}, in the last but one {signs[1]}"
    )
    print("| minutes | read of the log | resident memory, MB | threads | open files |")
    print("| ---: | ---: | ---: | ---: | ---: |")
    for part in np.array_split(samples, ROWS):
        minutes, share, memory, threads, files = part[-1]
        highest = part[:, 2].max()
        print(
            f"| {minutes:.1f} | {100 * share:.0f} % | {memory:.0f}, at most {highest:.0f} | {threads:.0f} |"
            f" {files:.0f} |"
        )
    late = samples[len(samples) // 5 :]
    slope, start = np.polyfit(late[:, 0] - late[0, 0], late[:, 2], 1)
    grown = slope * (late[-1, 0] - late[0, 0])
    print(
        f"a line through the last four fifths begins at {start:.0f} MB and rises by {grown:.1f} MB"
    )
    return int(grown > args.growth * start)


def watched(running: subprocess.Popen[bytes], log: Path) -> np.ndarray:
    """Minutes, share of the log's bytes at which reading stands, resident MB, threads, open files: a row a sample."""
    process, started = Path("/proc") / str(running.pid), time.monotonic()
    size, rows, share = log.stat().st_size, [], 0.0
    while running.poll() is None:
        time.sleep(SAMPLE_S)
        try:
            status = dict(
                line.split(":", 1) for line in (process / "status").read_text().splitlines()
            )
            opened = list((process / "fd").iterdir())
            memory = float(status["VmRSS"].split()[0]) / 1024
            for one in opened:
                if one.resolve() == log.resolve():
                    place = (process / "fdinfo" / one.name).read_text().split()[1]
                    share = int(place) / size
        except (OSError, KeyError):  # it has just ended
            continue
        rows.append(
            (
                (time.monotonic() - started) / 60,
                share,
                memory,
                float(status["Threads"]),
                len(opened),
            )
        )
        if len(rows) % 30 == 0:
            print(rows[-1], file=sys.stderr, flush=True)
    return np.array(rows)


if __name__ == "__main__":
    sys.exit(main())
