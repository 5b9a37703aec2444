"""A fleet of many short logs, one worker killed midway: whether every log is done, and what the engine costs.

    .venv/bin/python -m benchmarks.fleet --work .cache/fleet [--passes 50] [--images 6] [--shrink 2] [--jobs 2]

The demo drive is cut into pieces of a few images, made smaller (800 x 600). Each pass writes the pieces as logs again
with its own noise of poses and satellite fixes, half of the passes two years later. The same images in every pass make
this a test of the engine, not of recall. Then `wayside fleet` runs all logs; when half of them are done,
the process that runs one of the others gets SIGKILL. The same command is given once more. Prints the table of
benchmarks/fleet.md and ends with status 1 where a log is not done.

Overhead a log: jobs times wall time, less the sum of what the runs state as their own wall time (`run.json`), by the
number of logs: starting workers, loading models, keeping the manifest and waiting at the end.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from recordings.drives.alignment import build_alignment
from recordings.drives.logs import write_log
from recordings.drives.poses import drive_poses
from recordings.drives.spec_file import find_spec, load_spec
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.settings import ReadSettings

DEMO = Path(__file__).parents[1] / "recordings" / "demo.mcap"
YEARS_NS = 2 * 365 * 24 * 3600 * 10**9
DAY_NS = 24 * 3600 * 10**9


def main() -> int:
    """Make the logs, run, kill, judge, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, required=True, help="folder for logs and inventory")
    parser.add_argument("--passes", type=int, default=50)
    parser.add_argument("--images", type=int, default=6, help="of each log")
    parser.add_argument("--shrink", type=int, default=2, help="by so much smaller images")
    parser.add_argument("--set", action="append", default=[], help="as of wayside fleet")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--command", default=str(Path(sys.executable).with_name("wayside")))
    args = parser.parse_args()
    logs, inventory = args.work / "logs", args.work / "inventory"
    if not logs.exists():
        make_logs(logs, args.passes, args.images, args.shrink)
    count = len(list(logs.rglob("*.mcap")))
    shutil.rmtree(inventory, ignore_errors=True)
    line = [args.command, "fleet", str(logs), "-o", str(inventory)]
    line += ["--jobs", str(args.jobs), "--workers", "1"]
    line += [part for assignment in args.set for part in ("--set", assignment)]
    start = time.monotonic()
    running = subprocess.Popen(line)
    killed = kill_one(inventory, count // 2, lambda: running.poll() is None)
    status = running.wait()
    wall = time.monotonic() - start
    entries = read_logs(inventory)
    start = time.monotonic()
    again = subprocess.run(line, check=False, stdout=subprocess.DEVNULL).returncode
    idle = time.monotonic() - start
    done = sum(entry["state"] == "done" for entry in entries)
    runs = sum(entry["seconds"] for entry in entries)
    twice = [entry["name"] for entry in entries if entry["attempts"] > 1]
    rows = {
        "logs, images": f"{count}, {sum(entry['images'] for entry in entries)}",
        "worker killed while it ran": f"{killed}, after {count // 2} logs",
        "logs done, begun twice": f"{done}, {', '.join(twice)}",
        "exit status": str(status),
        "wall time": f"{wall:.0f} s on {args.jobs} workers",
        "sum of the runs' own wall times": f"{runs:.0f} s",
        "overhead a log": f"{(args.jobs * wall - runs) / count:.2f} s of a worker",
        "rows of signs before merging": str(sum(entry["rows"] for entry in entries)),
        "the same command once more": f"{idle:.1f} s, exit status {again}, nothing run",
    }
    print("| what | figure |\n| --- | --- |")
    for name, figure in rows.items():
        print(f"| {name} | {figure} |")
    return 0 if done == count and status in (0, 4) and killed in twice else 1


def make_logs(folder: Path, passes: int, count: int, shrink: int) -> None:
    """Write the demo drive as so many passes of logs of `count` images."""
    spec = load_spec(find_spec("demo"))
    full = spec.camera
    camera = replace(
        full,
        width=full.width // shrink,
        height=full.height // shrink,
        fx=full.fx / shrink,
        fy=full.fy / shrink,
        cx=(full.cx + 0.5) / shrink - 0.5,  # pixel centres at integers
        cy=(full.cy + 0.5) / shrink - 0.5,
    )
    spec = replace(spec, camera=camera)
    images = []
    for frame in read_frames(DEMO, ReadSettings(), ReadReport()):
        pixels = cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_COLOR)
        small = cv2.resize(pixels, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        images.append(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes())
    poses = drive_poses(spec, build_alignment(spec.road, spec.path.heading_deg))
    for number in range(passes):
        later = number * DAY_NS + (YEARS_NS if number >= passes // 2 else 0)
        shifted = [replace(pose, time_ns=pose.time_ns + later) for pose in poses]
        for piece, first in enumerate(range(0, len(images), count)):
            own = slice(first, first + count)
            path = folder / f"pass{number:02d}" / f"piece{piece}.mcap"
            path.parent.mkdir(parents=True, exist_ok=True)
            noise = replace(spec, seed=1000 * (number + 1) + piece)
            write_log(path, noise, shifted[own], images[own])


def kill_one(inventory: Path, after: int, alive: Callable[[], bool]) -> str:
    """Kill the process that runs a log, when so many are done; the name of that log."""
    while alive():
        time.sleep(0.5)
        entries = read_logs(inventory)
        if sum(entry["state"] == "done" for entry in entries) < after:
            continue
        for entry in entries:
            if entry["state"] != "running":
                continue
            said = (inventory / "logs" / f"{entry['name']}.txt").read_text().splitlines()
            found = re.search(r" begun .* process (\d+):", said[-1])  # else it is done by now
            if found:
                os.kill(int(found[1]), signal.SIGKILL)
                return str(entry["name"])
    return "none"


def read_logs(inventory: Path) -> list[dict[str, Any]]:
    """The logs of `fleet.json`, none before there is one."""
    file = inventory / "fleet.json"
    return list(json.loads(file.read_text())["logs"].values()) if file.exists() else []


if __name__ == "__main__":
    sys.exit(main())
