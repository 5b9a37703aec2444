"""What recording a run costs: processor time with the recording over that without, and its size.

    .venv/bin/python benchmarks/viewing.py .cache/drives/straight.mcap [--times 4] [--rounds 3]

Each round runs all ways one after the other, so that a busy machine is busy for all; the ratios are of medians. Writes
benchmarks/viewing.md.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path

from costs import play, run

WAYS = {
    "without": (),
    "file, no images": ("--view", "file", "--view-images", "none"),
    "file": ("--view", "file"),
    "file, with label images": ("--view", "file", "--view-detail"),
}
TABLE = Path(__file__).with_name("viewing.md")


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--times", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--spacing", default="26.4ft")
    args = parser.parse_args()
    seconds: dict[str, list[float]] = {way: [] for way in WAYS}
    size: dict[str, float] = {}
    images = 0
    with tempfile.TemporaryDirectory() as scratch:
        log, out = Path(scratch) / "log.mcap", Path(scratch) / "out"
        play(args.log, log, args.times)
        run(log, out, args.spacing, 2)  # compiles kernels where no cache is
        for _ in range(args.rounds):
            for way, options in WAYS.items():
                result, _, processor = run(log, out, args.spacing, 2, *options)
                seconds[way].append(processor)
                images = result["accounting"]["frames_read"]
                recording = out / "drive.rrd"
                size[way] = recording.stat().st_size / images if recording.exists() else 0.0
    base = statistics.median(seconds["without"])
    lines = [
        "# What recording a run costs",
        "",
        f"Made by `python benchmarks/viewing.py {args.log}`: {images} images of 1600 x 1200, two workers; medians "
        f"of {args.rounds} rounds, all ways in each. Processor time is that of the whole process, start included.",
        "",
        "| recording | processor time per image | over a run without | kB per image |",
        "| --- | ---: | ---: | ---: |",
    ]
    for way in WAYS:
        middle = statistics.median(seconds[way])
        over = "" if way == "without" else f"{100 * (middle / base - 1):+.1f} %"
        lines.append(
            f"| {way} | {1000 * middle / images:.0f} ms | {over} | {size[way] / 1000:.0f} |"
        )
    TABLE.write_text("\n".join(lines) + "\n")
    print(TABLE.read_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
