"""Options that several commands share, and the settings that they make."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayside.pipeline.cli.help import DETECT, READ, ROUTE, VIEW
from wayside.pipeline.files.lengths import parse_memory, parse_spacing, parse_time
from wayside.schemas.errors import UsageError

if TYPE_CHECKING:
    from wayside.schemas.settings import Settings

Command = Callable[..., None]
_MEASURE = re.compile(r"(\d+\.?\d*|\.\d+)\s*([a-z]*)")


class Preset(StrEnum):
    """Which chain of stages."""

    default = "default"
    report_shape = "report-shape"
    report_2d = "report-2d"
    report = "report"


class ViewMode(StrEnum):
    """Where a run's recording goes."""

    none = "none"
    file = "file"
    live = "live"
    serve = "serve"


class RecordedImages(StrEnum):
    """Which images a recording holds."""

    all = "all"
    signs = "signs"
    none = "none"


Log = Annotated[
    Path, typer.Argument(metavar="LOG", help="An MCAP file, a ROS 2 bag directory, a ROS 1 bag.")
]
Out = Annotated[Path, typer.Argument(metavar="OUT", help="Folder written by `wayside run`.")]
MovedLog = Annotated[
    Path | None, typer.Option(help="Where the log lies now, if it has moved since the run.")
]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace what stands there under the names of the output."),
]


@dataclass(frozen=True, slots=True)
class Option:
    """An option that several commands share, or one of the many of a command."""

    kind: Any
    """Type of its value; None may stand for it where there is no default."""
    help: str
    panel: str | None = None
    """Heading that it stands under in the help."""
    sets: str = ""
    """The setting, or field, that it is by another name."""
    parsed: Callable[..., Any] = str
    """Makes the value of what is given, and takes the option's name where that is a text with a unit."""
    names: tuple[str, ...] = ()
    metavar: str | None = None
    default: Any = None

    def parameter(self, name: str, panel: str | None) -> inspect.Parameter:
        """As a parameter of a command."""
        option = typer.Option(
            *self.names, help=self.help, rich_help_panel=panel or self.panel, metavar=self.metavar
        )
        kind = self.kind if self.default is not None else self.kind | None
        return inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=self.default,
            annotation=Annotated[kind, option],
        )


SHARED = {
    "spacing": Option(
        str,
        "Distance between images, where the log has no poses: 26.4ft, 8m.",
        READ,
        "read.spacing_m",
        parse_spacing,
    ),
    "camera": Option(str, "Image topic, where the log has several.", READ, "read.camera"),
    "calibration": Option(
        Path,
        "YAML of ROS, OpenCV or Kalibr instead of the log's calibration.",
        READ,
        "read.calibration",
    ),
    "start": Option(
        str,
        "Start here: 90s or 1:30.",
        READ,
        "read.from_s",
        partial(parse_time, option="--from"),
        ("--from",),
    ),
    "until": Option(
        str, "Stop here: 120s or 2:00.", READ, "read.until_s", partial(parse_time, option="--until")
    ),
    "every": Option(int, "Use every n-th image.", READ, "read.every", int),
    "workers": Option(int, "Images processed side by side.", None, "run.workers", int),
    "memory": Option(
        str, "Images under way take so much at most: 2GB.", None, "run.memory_mb", parse_memory
    ),
    "preset": Option(
        Preset,
        "`default` finds the most; `report`, `report-2d` and `report-shape` are the chains of KS-09-9.",
        DETECT,
        metavar="PRESET",
        default=Preset.default,
    ),
    "settings": Option(Path, "TOML file as `wayside settings` prints it.", DETECT),
    "assignments": Option(
        list[str],
        "Change one setting; may be repeated.",
        DETECT,
        names=("--set",),
        metavar="GROUP.NAME=VALUE",
    ),
    "detector": Option(
        Path,
        "ONNX file of a YOLO or RT-DETR detector, instead of wayside's own.",
        DETECT,
        "models.detector",
    ),
    "detections": Option(
        Path,
        "Boxes made elsewhere, Parquet or COCO JSON, instead of wayside's own.",
        DETECT,
        "models.detections",
    ),
    "classes": Option(
        Path,
        "TOML: which classes of these are signs, and their colours and shapes.",
        DETECT,
        "models.classes",
    ),
    "models": Option(
        Path,
        "Model files of your own, as `wayside fit` writes them.",
        DETECT,
        "models.folder",
        metavar="DIR",
    ),
    "alpha": Option(
        float,
        "False-alarm rate of every gate, instead of the thresholds of the models.",
        DETECT,
        "models.alpha",
        float,
    ),
    "route": Option(str, 'Route of the drive: "US-36 EB".', ROUTE, "route.name", metavar="NAME"),
    "milepost": Option(str, "Measure at the first used image: 12.35 (miles), 19.875km.", ROUTE),
    "decreasing": Option(
        bool,
        "Mileposts fall in the direction of travel.",
        ROUTE,
        "route.decreasing",
        bool,
        ("--decreasing",),
        default=False,
    ),
    "routes": Option(
        Path,
        "Route lines with measures (M), GeoPackage or GeoParquet; needs fixes.",
        ROUTE,
        "route.file",
        metavar="FILE",
    ),
    "view": Option(
        ViewMode,
        "Record every step: `file` drive.rrd in the output folder, `live` a viewer's window, `serve` a viewer in the "
        "browser.",
        VIEW,
        default=ViewMode.none,
    ),
    "connect": Option(
        str, "Also send to a viewer that runs already: 127.0.0.1:9876.", VIEW, metavar="URL"
    ),
    "view_images": Option(
        RecordedImages,
        "Images to record: all, those with signs, none.",
        VIEW,
        default=RecordedImages.all,
    ),
    "view_detail": Option(
        bool,
        "Presets of the report: also record the label images of both passes.",
        VIEW,
        names=("--view-detail",),
        default=False,
    ),
}
"""Options that several commands share."""


def takes(
    *names: str, heading: str | None = None, options: Mapping[str, Option] = SHARED
) -> Callable[[Command], Command]:
    """Give a command options of a table, which its parameter `given` (``**given``) holds by name.

    In the help they stand behind the arguments and options that must be given, under their own headings or `heading`.
    """

    def declared(command: Command) -> Command:
        *own, _ = inspect.signature(command, eval_str=True).parameters.values()
        own = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own]
        needed = [one for one in own if one.default is one.empty]
        rest = [one for one in own if one.default is not one.empty]
        shared = [options[name].parameter(name, heading) for name in names]
        every = [*needed, *shared, *rest]
        command.__signature__ = inspect.Signature(every)  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in every}
        return command

    return declared


def settings_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are settings by another name, by that name, those given only.

    Raises
    ------
    UsageError
        One of them cannot be parsed.
    """
    options = {
        SHARED[name].sets: SHARED[name].parsed(value)
        for name, value in given.items()
        if value is not None and value is not False and name in SHARED and SHARED[name].sets
    }
    if given.get("milepost") is not None:
        options |= parse_milepost(given["milepost"])
    return options


def chosen_settings(given: Mapping[str, Any]) -> Settings:
    """Settings of a preset, a file, `--set` and options, later ones win; raises UsageError."""
    from wayside.pipeline.files.settings_file import load_settings

    preset, file = given.get("preset", Preset.default), given.get("settings")
    options = settings_of(given)
    return load_settings(preset.value, file, given.get("assignments") or [], options)[0]


def parse_milepost(text: str) -> dict[str, Any]:
    """Measure and unit of a milepost as settings: "12.35" and "12.35mi" are miles, "19.875km" kilometres.

    Raises
    ------
    UsageError
        The text is no milepost.
    """
    from wayside.schemas.routes import MEASURE_UNITS

    found = _MEASURE.fullmatch(text.strip().lower())
    if found is None or (found[2] and found[2] not in MEASURE_UNITS):
        raise UsageError(
            f"--milepost: {text!r} is not a measure. Write 12.35 (miles) or 19.875km; the units are "
            f"{', '.join(MEASURE_UNITS)}."
        )
    unit = {"route.unit": found[2]} if found[2] else {}
    return {"route.milepost": float(found[1]), **unit}


def parse_size(text: str, option: str, smallest: int, largest: int) -> tuple[int, int]:
    """Width and height of a picture in pixels, both within bounds; raises UsageError."""
    width, _, height = text.lower().partition("x")
    if width.isdecimal() and height.isdecimal():
        size = int(width), int(height)
        if smallest <= min(size) and max(size) <= largest:
            return size
    raise UsageError(
        f"{option}: {text!r} is not a size of {smallest} to {largest} pixels. Write width x height, as in 1600x1000."
    )
