"""Runs of wayside on rendered drives with more or less of what was recorded, and the tables they end in."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.evaluation import RenderedEvaluation, evaluate_against_truth
from wayside.schemas.frame import Camera, Pose

ROOT = Path(__file__).resolve().parents[1]
DRIVES, RESULTS = ROOT / ".cache" / "drives", ROOT / ".cache" / "geometry"
NAMES = ("straight", "curve")
SPACING = "26.4ft"
NOTHING_ELSE, FIXES = ("Image", "Camera"), ("Image", "Camera", "NavSat", "LocationFix")
POSES_GIVEN, SPACING_ONLY, FIXES_AND_SPACING, FIXES_ONLY = (
    "poses given",
    "images and spacing only",
    "fixes and spacing",
    "fixes only",
)
WAYS = {
    POSES_GIVEN: None,
    SPACING_ONLY: NOTHING_ELSE,
    FIXES_AND_SPACING: FIXES,
    FIXES_ONLY: FIXES,
}
"""What a run is given, and which messages of the log it keeps for that."""
Array = NDArray[np.float64]


@dataclass
class Run:
    """One run of wayside on one variant of a drive."""

    name: str
    way: str
    folder: Path
    truth: dict[str, Any]
    processor_s: float
    signs: list[dict[str, Any]] = field(default_factory=list)

    def evaluation(self, below: int | None = None) -> RenderedEvaluation:
        """Compare with the truth: all signs, or those whose best image comes before one."""
        rows = [s for s in self.signs if below is None or s["best_frame"] < below]
        return evaluate_against_truth(rows, self.truth)


def render() -> None:
    """Make the rendered drives that are not there yet."""
    specs = [f"recordings/drives/specs/{name}.toml" for name in NAMES]
    command = [sys.executable, "-m", "recordings.drives", *specs, "-o", str(DRIVES), "--missing"]
    subprocess.run(command, cwd=ROOT, check=True)


def run(name: str, way: str) -> Run:
    """Run wayside on a drive as recorded, or with part of its messages."""
    log, keep = DRIVES / f"{name}.mcap", WAYS[way]
    folder = RESULTS / f"{name}-{way.replace(' ', '-')}"
    if keep is not None:
        part = RESULTS / f"{folder.name}.mcap"
        strip(log, part, keep)
        log = part
    command = [sys.executable, "-c", "from wayside.pipeline.cli import main; main()", "run"]
    command += [
        str(log),
        "-o",
        str(folder),
        "--overwrite",
        "--workers",
        "1",
        "--set",
        "read.thin_m=0",
    ]
    if way in (SPACING_ONLY, FIXES_AND_SPACING):
        command += ["--spacing", SPACING]
    spent = processor_seconds(command)
    truth = json.loads((DRIVES / f"{name}.truth.json").read_text())
    rows = pq.read_table(folder / "signs.parquet").to_pylist()
    return Run(name, way, folder, truth, spent, [r for r in rows if r["status"] == "sign"])


def strip(source: Path, target: Path, keep: Iterable[str]) -> None:
    """Copy the messages of a log whose schema is of one of these kinds."""
    with source.open("rb") as log, target.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start()
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(log).iter_messages():
            if schema is None or not any(kind in schema.name for kind in keep):
                continue
            if channel.id not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, known
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()


def processor_seconds(command: list[str]) -> float:
    """Run a process to its end; what it cost."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def true_poses(truth: dict[str, Any]) -> dict[int, Pose]:
    """Pose of each image."""
    return {
        f["index"]: Pose(Rotation.from_quat(f["quaternion"]).as_matrix(), np.array(f["position"]))
        for f in truth["frames"]
    }


def camera_of(truth: dict[str, Any]) -> Camera:
    """The rendered camera."""
    c = truth["camera"]
    size, focal = (c["width"], c["height"]), (c["fx"], c["fy"])
    return Camera(*size, *focal, c["cx"], c["cy"], tuple(c["distortion"]))


def heading(text: str) -> list[str]:
    """Head of a table."""
    names = text.split("|")
    return [row(names), "| --- |" + " ---: |" * (len(names) - 1)]


def row(cells: Iterable[str]) -> str:
    """A line of a table."""
    return "| " + " | ".join(cells) + " |"


def pair(middle: float | None, tail: float | None, scale: float) -> str:
    """Median and tail."""
    return "-" if middle is None or tail is None else f"{scale * middle:.1f} / {scale * tail:.1f}"
