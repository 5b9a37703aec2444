"""Corrupts a tenth of the images of a rendered drive and compares the signs that are left with its truth.

    .venv/bin/python benchmarks/reliability_images.py recordings/demo.mcap [--draws 6] [--share 0.1] [--scale 1]

Which images, and how, is drawn by chance: cut off, bytes overwritten, emptied. The truth is the `.truth.json` beside
the log. Errors are those of rows with status sign or back in the camera of their best frame (right, down, ahead), in
the standard deviations that the row states. Two runs of one drive share most of their views, so that the distance of
one from the other has no error bar of its own; that of each from the truth has. Of n such errors all are below a limit
in 95 of 100 programs if they are independent and normal. Ends with status 1 where an error of a drive with corrupted
images is above this limit and above the largest of the whole drive, or where an image that was corrupted is used.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from logged_messages import IMAGE, Messages, edited, read_log, write_log
from numpy.typing import NDArray
from reliability_attacks import scaled
from reliability_clocks import run_attack
from scipy.spatial.transform import Rotation
from scipy.stats import norm

NEAREST_M = 3.0
PLACE = ("right_m", "down_m", "ahead_m")
SIGMA = ("sigma_lateral_m", "sigma_up_m", "sigma_along_m")


def main() -> int:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--draws", type=int, default=6)
    parser.add_argument("--share", type=float, default=0.1)
    parser.add_argument("--scale", type=float, default=1.0, help="size of the images")
    args = parser.parse_args()
    truth = json.loads(args.log.with_suffix(".truth.json").read_text())
    print(
        "| drive | exit | images used | sign, back | uncertain | of no panel | within 1, 2 sigma | farthest, sigmas |"
    )
    print("| --- | ---: | --- | ---: | ---: | ---: | ---: | ---: |")
    good, all_errors, messages = True, [], scaled(read_log(args.log), args.scale)
    with tempfile.TemporaryDirectory() as scratch:
        for draw in range(-1, args.draws):
            log, out = Path(scratch) / "drive.mcap", Path(scratch) / f"out{draw}"
            attacked, count = corrupted(messages, args.share, draw) if draw >= 0 else (messages, 0)
            write_log(log, attacked)
            found = run_attack(log, out, ())
            good &= found.used == found.images - count
            errors, status = sigmas_off(out, truth)
            all_errors.append(errors)
            within = " ".join(f"{np.mean(np.abs(errors) < k):.0%}" for k in (1, 2))
            name = f"{count} corrupted, draw {draw}" if count else "whole"
            print(
                f"| {name} | {found.status} | {found.used} of {found.images} | {status['sign'] + status['back']} | "
                f"{status['uncertain']} | {status['of no panel']} | {within} | {np.abs(errors).max(initial=0):.1f} |",
                flush=True,
            )
    whole, far = np.abs(all_errors[0]), np.abs(np.concatenate(all_errors[1:]))
    limit = max(norm.ppf((1 + 0.95 ** (1 / max(far.size, 1))) / 2), whole.max(initial=0))
    print(
        f"\n{far.size} errors of drives with corrupted images, {np.mean(far < 1):.0%} within 1, {np.mean(far < 2):.0%} "
        f"within 2, the largest {far.max(initial=0):.1f}; all are to be below {limit:.1f}"
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


def sigmas_off(out: Path, truth: dict[str, Any]) -> tuple[NDArray[np.float64], Counter[str]]:
    """Errors (3n,) of the rows that are reported as signs or backs, in standard deviations, and rows by status.

    A row is of the nearest true panel; one without any within `NEAREST_M` counts as `of no panel` and has no error.
    """
    frames = {frame["index"]: frame for frame in truth["frames"]}
    centres = np.array([panel["centre"] for panel in truth["signs"]])
    errors: list[float] = []
    rows: Counter[str] = Counter()
    for row in pq.read_table(out / "signs.parquet").to_pylist():
        rows[row["status"]] += 1
        if row["status"] == "uncertain":
            continue
        frame = frames[row["best_frame"]]
        to_world = Rotation.from_quat(frame["quaternion"]).as_matrix()
        off = np.array([row[name] for name in PLACE]) - (centres - frame["position"]) @ to_world
        nearest = off[np.linalg.norm(off, axis=1).argmin()]
        if np.linalg.norm(nearest) < NEAREST_M:
            errors += (nearest / [row[name] for name in SIGMA]).tolist()
        else:
            rows["of no panel"] += 1
    return np.array(errors), rows


if __name__ == "__main__":
    sys.exit(main())
