"""Options of the commands that run logs, and the settings that they make. Heavy imports stand inside."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayside.pipeline.cli_help import DETECT, READ

if TYPE_CHECKING:
    from wayside.schemas.settings import Settings


class Preset(StrEnum):
    """Which chain of stages."""

    default = "default"
    report_shape = "report-shape"
    report_2d = "report-2d"
    report = "report"


SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings", rich_help_panel=DETECT, help="TOML file as `wayside settings` prints it."
    ),
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        rich_help_panel=DETECT,
        metavar="GROUP.NAME=VALUE",
        help="Change one setting; may be repeated.",
    ),
]
PresetOption = Annotated[
    Preset,
    typer.Option(
        rich_help_panel=DETECT,
        metavar="PRESET",
        help="`default` finds the most; "
        "`report`, `report-2d` and `report-shape` are the chains of KS-09-9.",
    ),
]


Spacing = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=READ,
        help="Distance between images, where the log has no poses: 26.4ft, 8m.",
    ),
]
CameraTopic = Annotated[
    str | None, typer.Option(rich_help_panel=READ, help="Image topic, where the log has several.")
]
Calibration = Annotated[
    Path | None,
    typer.Option(
        rich_help_panel=READ, help="YAML of ROS, OpenCV or Kalibr instead of the log's calibration."
    ),
]
From = Annotated[
    str | None, typer.Option("--from", rich_help_panel=READ, help="Start here: 90s or 1:30.")
]
Until = Annotated[str | None, typer.Option(rich_help_panel=READ, help="Stop here: 120s or 2:00.")]
Every = Annotated[int | None, typer.Option(rich_help_panel=READ, help="Use every n-th image.")]
Workers = Annotated[int | None, typer.Option(help="Images processed side by side.")]
Memory = Annotated[str | None, typer.Option(help="Images under way take so much at most: 2GB.")]


def read_options(
    spacing: str | None,
    camera: str | None,
    calibration: Path | None,
    start: str | None,
    until: str | None,
    every: int | None,
    workers: int | None,
    memory: str | None = None,
) -> dict[str, Any]:
    """Options that are settings by another name, those given only."""
    from wayside.pipeline.lengths import parse_memory, parse_spacing, parse_time

    options: dict[str, Any] = {
        "read.spacing_m": None if spacing is None else parse_spacing(spacing),
        "read.camera": camera,
        "read.calibration": None if calibration is None else str(calibration),
        "read.from_s": None if start is None else parse_time(start, "--from"),
        "read.until_s": None if until is None else parse_time(until, "--until"),
        "read.every": every,
        "run.workers": workers,
        "run.memory_mb": None if memory is None else parse_memory(memory),
    }
    return {name: value for name, value in options.items() if value is not None}


def chosen_settings(
    preset: Preset, file: Path | None, assignments: list[str] | None, options: dict[str, Any]
) -> Settings:
    """Settings of a preset, a file, `--set` and options, later ones win; raises UsageError."""
    from wayside.pipeline.settings_file import load_settings

    return load_settings(preset.value, file, assignments or [], options)[0]
