"""What is known of lengths on a real drive, beside what is measured there."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from wayside.pipeline.box_matching import same_thing

DRIVE, SPACING = "de_road_kitti0015", "6.15m"
SIZES = {"R1": (0.90, 0.78), "R3": (0.60, 0.60)}
"""Nominal width and height, metres: a warning triangle of 900 mm side, a limit disc of 600 mm."""
APART = ("R1", "R3", 28.6)
"""Two signs and how far one stands behind the other, metres, from when each is passed and 80 m between two beacons."""


def real_table(real: Path, results: Path) -> list[str]:
    """The section on the real drive; says so where the drive is not at hand."""
    log, labels = real / f"{DRIVE}.mcap", real / f"{DRIVE}.labels.json"
    lines = ["", "## A real drive", ""]
    if not log.is_file():
        return [*lines, f"{DRIVE} was not at hand."]
    out = results / DRIVE
    command = [str(Path(sys.executable).with_name("wayside")), "run", str(log), "-o", str(out)]
    command.append("--overwrite")
    subprocess.run([*command, "--spacing", SPACING], check=True, capture_output=True)
    known = {sign["id"]: sign for sign in json.loads(labels.read_text())["signs"]}
    rows = {name: found_row(out, known[name]) for name in SIZES}
    lines += [
        f"`{DRIVE}`: images and an estimated spacing of {SPACING}, calibration as published. Nothing there was "
        "surveyed: sizes are those of the regulations, the distance follows from 80 m between two beacons (whose boxes "
        "say that either is some 5 % off).",
        "",
        "| what | nominal | measured |",
        "| --- | ---: | ---: |",
    ]
    for name, (width, height) in SIZES.items():
        row = rows[name]
        measured = "not found" if row is None else size_words(row)
        lines.append(f"| {known[name]['what']} | {width:.2f} x {height:.2f} m | {measured} |")
    first, second = rows[APART[0]], rows[APART[1]]
    if first is not None and second is not None:
        apart = f"{second['station_m'] - first['station_m']:.1f} m"
    else:
        apart = "not found"
    lines.append(f"| from the one to the other, along the road | {APART[2]:.1f} m | {apart} |")
    return lines


def size_words(row: dict[str, Any]) -> str:
    """Width and height with their standard deviations."""
    return (
        f"{row['panel_width_m']:.2f} ± {row['sigma_width_m']:.2f} x "
        f"{row['panel_height_m']:.2f} ± {row['sigma_height_m']:.2f} m"
    )


def found_row(out: Path, label: dict[str, Any]) -> dict[str, Any] | None:
    """The row of `signs.parquet` that lies on a label, None where there is none."""
    boxes = {entry["i"]: entry["box"] for entry in label["boxes"]}
    table = pq.read_table(out / "observations.parquet", columns=["sign_id", "frame", "box"])
    names = {
        row["sign_id"]
        for row in table.to_pylist()
        if row["sign_id"] and row["frame"] in boxes and same_thing(row["box"], boxes[row["frame"]])
    }
    rows = pq.read_table(out / "signs.parquet").to_pylist()
    return next((row for row in rows if row["sign_id"] in names), None)
