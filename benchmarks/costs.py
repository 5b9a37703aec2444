"""What a run costs: images per second, processor time by stage, peak memory of a short and of a long log.

    .venv/bin/python benchmarks/costs.py .cache/drives/straight.mcap [--times 20]

The long log is the short one played over and over: its images and calibration only, times moved on, so both run from
the known spacing. Also compares the bytes that one and two workers write. Prints a table; writes nothing but scratch.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from common import WAYSIDE, processor_seconds
from faulty_logs import CALIBRATION, IMAGE, Logged, edited, read_log, write_log

TABLES = ("signs.parquet", "observations.parquet", "frames.parquet")
PAUSE_NS = 300_000_000
"""Between two turns."""


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--spacing", default="26.4ft")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        short, long = folder / "short.mcap", folder / "long.mcap"
        play(args.log, short, 1)
        play(args.log, long, args.times)
        run(short, folder / "warm", args.spacing, 2)  # compiles kernels where no cache is
        digests = {}
        for workers in (1, 2):
            result, peak, processor = run(
                short, folder / f"workers{workers}", args.spacing, workers
            )
            digests[workers] = [result["files"][name]["sha256"] for name in TABLES]
            report(f"short log, {workers} worker(s)", result, peak, processor)
        _, short_peak, _ = run(short, folder / "short", args.spacing, 2)
        result, long_peak, processor = run(long, folder / "long", args.spacing, 2)
        report(f"played {args.times} times over, 2 workers", result, long_peak, processor)
        same = digests[1] == digests[2]
        print(f"the same bytes from 1 and 2 workers: {'yes' if same else 'NO'}")
        print(f"peak memory, long over short: {long_peak / short_peak:.3f}")
        for stage, seconds in result["times"]["cpu_s_by_stage"].items():
            print(
                f"  {stage:10s} {1000 * seconds / result['accounting']['frames_read']:7.1f} ms processor time per image"
            )
    return 0 if same else 1


def play(source: Path, target: Path, times: int) -> None:
    """Copy images and calibration of a log, `times` over with times moved on."""
    messages = [m for m in read_log(source) if m.topic in (IMAGE, CALIBRATION)]
    length_ns = messages[-1].log_ns - messages[0].log_ns + PAUSE_NS
    write_log(target, (later(m, turn, length_ns) for turn in range(times) for m in messages))


def later(message: Logged, turn: int, length_ns: int) -> Logged:
    """The message as it is logged in a later turn."""
    moved = edited(message, header_ns=turn * length_ns, log_ns=turn * length_ns)
    return replace(moved, data=numbered(moved.data, turn))


def numbered(message: bytes, turn: int) -> bytes:
    """The message with a number in the density of its JPEG, which no decoder heeds: equal images are left out."""
    start = message.find(b"\xff\xd8\xff\xe0")
    if start < 0:
        return message
    density = start + 14  # behind the markers, the length, "JFIF", the version and the unit
    return message[:density] + (turn + 1).to_bytes(4, "big") + message[density + 4 :]


def run(log: Path, out: Path, spacing: str, workers: int, *more: str) -> tuple[dict, float, float]:
    """Run the command as a process of its own; `run.json`, peak memory (MB) and processor seconds."""
    command = [WAYSIDE, "run", str(log), "-o", str(out), "--overwrite", "--spacing", spacing]
    command += ["--workers", str(workers), "--set", "read.thin_m=0", *more]
    before = processor_seconds()
    watch = f"import resource,subprocess,sys; code=subprocess.call({command!r}, stdout=subprocess.DEVNULL); "
    watch += "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(code)"
    done = subprocess.run([sys.executable, "-c", watch], check=True, capture_output=True, text=True)
    processor = processor_seconds() - before
    return (
        json.loads((out / "run.json").read_text()),
        int(done.stdout.split()[-1]) / 1024,
        processor,
    )


def report(what: str, result: dict, peak: float, processor: float) -> None:
    """Print one line of the table."""
    frames, wall = result["accounting"]["frames_read"], result["times"]["wall_s"]
    print(
        f"{what:36s} {frames:5d} images  {frames / wall:6.1f} images/s  "
        f"{1000 * processor / frames:6.0f} ms processor time per image  peak {peak:.0f} MB",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
