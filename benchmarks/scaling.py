"""How fast a drive would go with more workers, by the CPU times of a run.

    .venv/bin/python benchmarks/scaling.py OUT

Work on images and pairs is done side by side; the stages after it take one thread. The rate is that of the slower one.
"""

import json
import sys
from pathlib import Path

SIDE_BY_SIDE = (
    "decode",
    "propose",
    "detect",
    "features",
    "segment",
    "color",
    "shape",
    "sift",
    "ties",
)
"""Stages in the workers; whatever else a run counts is in order, in one thread."""


def main(folder: Path) -> None:
    """Print milliseconds an image of both parts, and images a second for several numbers of workers."""
    about = json.loads((folder / "run.json").read_text())
    images = about["accounting"]["used"]
    each = {name: 1e3 * s / images for name, s in about["times"]["cpu_s_by_stage"].items()}
    shared = sum(ms for name, ms in each.items() if name in SIDE_BY_SIDE)
    order = sum(each.values()) - shared
    print(f"side by side {shared:.1f} ms, in order {order:.1f} ms an image")
    for count in (1, 2, 4, 8, 16):
        slower = shared + order if count == 1 else max(order, (shared + order) / count)
        print(f"{count:2d} workers {1e3 / slower:6.1f} images/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
