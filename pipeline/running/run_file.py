"""`run.json`: how a result was made."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wayside.pipeline.files.output_folder import RECORDING
from wayside.pipeline.files.settings_file import settings_digest
from wayside.pipeline.files.writing import create, not_written
from wayside.pipeline.models.model_files import learned_from
from wayside.pipeline.results.earlier_result import file_digest, log_fingerprint
from wayside.pipeline.results.result import RUN_FILE
from wayside.pipeline.running.journal import result_key
from wayside.schemas.frame import USED

if TYPE_CHECKING:
    from wayside.pipeline.running.run import RunRequest, RunResult


def write_run(result: RunResult, asked: RunRequest, part: Path) -> None:
    """`run.json`: everything needed to repeat the run, and all that differs between two runs of it."""
    settings, models, drive = asked.settings, asked.models, result.inventory
    used = result.frames.get(USED, 0)
    rejected = {k: v for k, v in sorted(result.frames.items()) if k != USED}
    digests = models.digests()
    content: dict[str, Any] = {
        "wayside": version("wayside"),
        "arguments": list(asked.arguments),
        "log": result.log.name,
        "log_path": str(result.log.absolute()),
        "log_fingerprint": log_fingerprint(result.log),
        "camera_topic": result.report.camera_topic,
        "view_images": result.view_images,
        "recording": RECORDING if result.recorded else None,
        "settings": asdict(settings),
        "settings_digest": settings_digest(settings),
        "models": digests,
        "result_key": result_key(result.log, settings, digests, every_region=asked.every_region),
        "learned_from_log": list(learned_from(result.log.stem, models.provenances())),
        "detector": None if result.boxes is None else result.boxes.source,
        "camera": drive.camera and asdict(drive.camera),
        "world": drive.path.world,
        "camera_height_m": drive.path.camera_height_m,
        "camera_by_motion": result.lens.found and asdict(result.lens.found),
        "focal_length": {"correction": result.lens.correction, "sigma": result.lens.sigma},
        "us_probability": drive.us_probability,
        "notes": result.notes,
        "accounting": {
            "frames_read": sum(result.frames.values()),
            "used": used,
            "rejected": rejected,
            "regions": drive.verdicts,
            "boxes": None if result.boxes is None else result.boxes.counts,
            "lost": result.lost,
        },
        "files": {
            name: {"rows": rows, "sha256": file_digest(part / name)}
            for name, rows in drive.rows.items()
        },
        "times": {
            "wall_s": round(result.wall_seconds, 3),
            "replayed_frames": result.replayed,
            "cpu_s_by_stage": {k: round(v, 3) for k, v in result.stage_seconds.items()},
        },
        "memory": {
            "limit_mb": settings.run.memory_mb or None,
            "images_at_most_mb": round(result.image_bytes / 1e6, 1),
        },
        "machine": {
            "system": platform.platform(),
            "python": platform.python_version(),
            "cores": os.cpu_count(),
        },
    }
    try:
        with create(part / RUN_FILE) as stream:
            stream.write((json.dumps(content, indent=1) + "\n").encode())
    except OSError as error:
        raise not_written(part, error) from error
