"""Corrupts a tenth of the images of a drive and compares its signs with those of the whole drive.

    .venv/bin/python benchmarks/reliability_images.py recordings/demo.mcap [--draws 5] [--share 0.1] [--scale 1]

Which images, and how, is drawn by chance: cut off, bytes overwritten, emptied. Two signs are one where they are nearest
to each other and within 3 m. Distances are in standard deviations: the square root of d' C^-1 d, where C is the sum of
both covariances. Of n such distances all are below a limit in 95 of 100 programs if errors are independent and normal:
that of the chi distribution of three degrees of freedom at 0.95 to the power 1 / n (2.8 for one, 4.0 for fifty). Ends
with status 1 where a sign is farther, or an image that was corrupted is used.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from reliability_attacks import IMAGE, Messages, edited, read_log, scaled, write_log
from reliability_clocks import run_attack
from scipy.stats import chi

NEAREST_M = 3.0
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def main() -> int:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--share", type=float, default=0.1)
    parser.add_argument("--scale", type=float, default=1.0, help="size of the images")
    args = parser.parse_args()
    good, far = True, np.zeros(0)
    print(
        "| drive | exit | images used | signs found again | new | farthest, sigmas | median, sigmas |"
    )
    print("| --- | ---: | --- | --- | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as scratch:
        log, whole = Path(scratch) / "drive.mcap", Path(scratch) / "whole"
        messages = scaled(read_log(args.log), args.scale)
        write_log(log, messages)
        found = run_attack(log, whole, ())
        print(f"| whole | {found.status} | {found.used} of {found.images} | {found.rows} | | | |")
        for draw in range(args.draws):
            out = Path(scratch) / str(draw)
            attacked, count = corrupted(messages, args.share, draw)
            write_log(log, attacked)
            found = run_attack(log, out, ())
            apart, lost, new = sigmas_apart(whole, out)
            good &= found.used == found.images - count
            far = np.append(far, apart)
            print(
                f"| {count} corrupted, draw {draw} | {found.status} | {found.used} of {found.images} | {len(apart)} of "
                f"{len(apart) + lost} | {new} | {apart.max(initial=0):.1f} | {np.median(apart):.1f} |",
                flush=True,
            )
    limit = chi.ppf(0.95 ** (1 / max(len(far), 1)), 3)
    print(
        f"\n{len(far)} distances, {np.mean(far > chi.ppf(0.95, 3)):.0%} above {chi.ppf(0.95, 3):.1f}, the largest "
        f"{far.max(initial=0):.1f}; all are to be below {limit:.1f}"
    )
    return 0 if good and bool((far <= limit).all()) else 1


def corrupted(messages: Messages, share: float, seed: int) -> tuple[Messages, int]:
    """The messages with a share of the images damaged, and how many those are."""
    draw = random.Random(seed)
    images = [k for k, m in enumerate(messages) if m.topic == IMAGE]
    chosen = set(draw.sample(images, max(round(share * len(images)), 1)))

    def damage(content: Any) -> None:
        data, kind = bytearray(content.data), draw.randrange(3)
        at = draw.randrange(len(data) // 4, 3 * len(data) // 4)
        if kind == 0:
            del data[at:]
        elif kind == 1:
            data[at : at + 2000] = draw.randbytes(2000)
        else:
            data.clear()
        content.data = bytes(data)

    return [edited(m, damage) if k in chosen else m for k, m in enumerate(messages)], len(chosen)


def sigmas_apart(whole: Path, other: Path) -> tuple[np.ndarray, int, int]:
    """Distances of the signs of both in standard deviations, and how many only one of them has."""
    (a, ca), (b, cb) = places(whole), places(other)
    apart = np.linalg.norm(a[:, None] - b[None], axis=2)
    pairs = [
        (i, j)
        for i, j in enumerate(apart.argmin(axis=1) if len(b) else ())
        if apart[:, j].argmin() == i and apart[i, j] < NEAREST_M
    ]
    far = [
        float(np.sqrt((a[i] - b[j]) @ np.linalg.solve(ca[i] + cb[j], a[i] - b[j])))
        for i, j in pairs
    ]
    return np.array(far), len(a) - len(pairs), len(b) - len(pairs)


def places(out: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) and covariances (n, 3, 3) of the rows that are reported as signs or backs."""
    rows = [
        row
        for row in pq.read_table(out / "signs.parquet").to_pylist()
        if row["status"] != "uncertain"
    ]
    covariance = np.zeros((len(rows), 3, 3))
    for k, row in enumerate(rows):
        for (i, j), value in zip(UPPER, row["covariance"], strict=True):
            covariance[k, i, j] = covariance[k, j, i] = value
    return np.array([[row[c] for c in "xyz"] for row in rows]).reshape(-1, 3), covariance


if __name__ == "__main__":
    sys.exit(main())
