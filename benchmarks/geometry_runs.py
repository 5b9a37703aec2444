"""Runs of wayside on rendered drives with more or less of what was recorded, and the tables they end in."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from common import DRIVES, ROOT, processor_seconds, run_wayside
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.evaluation.figures import RenderedEvaluation
from wayside.pipeline.evaluation.rendered import evaluate_against_truth
from wayside.schemas.frame import Camera, Pose

FOLDER = ROOT / ".cache" / "geometry"
NAMES, SPACING = ("straight", "curve"), "26.4ft"
NOTHING_ELSE, FIXES = ("Image", "Camera"), ("Image", "Camera", "NavSat", "LocationFix")
POSES_GIVEN, SPACING_ONLY, FIXES_ONLY = "poses given", "images and spacing only", "fixes only"
WAYS = {POSES_GIVEN: None, SPACING_ONLY: NOTHING_ELSE, FIXES_ONLY: FIXES}
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


def run(name: str, way: str) -> Run:
    """Run wayside on a drive as recorded, or with part of its messages."""
    log, keep = DRIVES / f"{name}.mcap", WAYS[way]
    folder = FOLDER / f"{name}-{way.replace(' ', '-')}"
    if keep is not None:
        part = FOLDER / f"{folder.name}.mcap"
        strip(log, part, keep)
        log = part
    words = ["--overwrite", "--workers", "1", "--set", "read.thin_m=0"]
    words += ["--spacing", SPACING] if way == SPACING_ONLY else []
    before = processor_seconds()
    run_wayside("run", log, "-o", folder, *words, check=True)
    spent = processor_seconds() - before
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


def pair(middle: float | None, tail: float | None, scale: float) -> str:
    """Median and tail."""
    return "-" if middle is None or tail is None else f"{scale * middle:.1f} / {scale * tail:.1f}"
