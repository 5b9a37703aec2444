"""Options of the command line for boxes of another detector."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline.cli_help import DETECT
from wayside.schemas.errors import UsageError

Detector = Annotated[
    Path | None,
    typer.Option(
        rich_help_panel=DETECT,
        help="ONNX file of a YOLO or RT-DETR detector, instead of wayside's own.",
    ),
]
Detections = Annotated[
    Path | None,
    typer.Option(
        rich_help_panel=DETECT,
        help="Boxes made elsewhere, Parquet or COCO JSON, instead of wayside's own.",
    ),
]
Classes = Annotated[
    Path | None,
    typer.Option(
        rich_help_panel=DETECT,
        help="TOML: which classes of these are signs, and their colours and shapes.",
    ),
]


def options(detector: Path | None, detections: Path | None, classes: Path | None) -> dict[str, str]:
    """The options as settings, those given only."""
    given = {
        "models.detector": detector,
        "models.detections": detections,
        "models.classes": classes,
    }
    return {name: str(value) for name, value in given.items() if value is not None}


def require_one_log(logs: Sequence[Path]) -> None:
    """Refuse one file of boxes for several logs."""
    if len(logs) > 1:
        raise UsageError(
            f"--detections: wanted one log, found {len(logs)}; run each with boxes of its own"
        )
