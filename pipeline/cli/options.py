"""Options that several commands share, and the settings that they make."""

from __future__ import annotations

import copy
import inspect
import re
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

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
_SHARED: dict[str, Any] = {
    "spacing": Annotated[
        str | None,
        typer.Option(
            rich_help_panel=READ,
            help="Distance between images, where the log has no poses: 26.4ft, 8m.",
        ),
    ],
    "camera": Annotated[
        str | None,
        typer.Option(rich_help_panel=READ, help="Image topic, where the log has several."),
    ],
    "calibration": Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=READ,
            help="YAML of ROS, OpenCV or Kalibr instead of the log's calibration.",
        ),
    ],
    "start": Annotated[
        str | None, typer.Option("--from", rich_help_panel=READ, help="Start here: 90s or 1:30.")
    ],
    "until": Annotated[
        str | None, typer.Option(rich_help_panel=READ, help="Stop here: 120s or 2:00.")
    ],
    "every": Annotated[
        int | None, typer.Option(rich_help_panel=READ, help="Use every n-th image.")
    ],
    "workers": Annotated[int | None, typer.Option(help="Images processed side by side.")],
    "memory": Annotated[
        str | None, typer.Option(help="Images under way take so much at most: 2GB.")
    ],
    "preset": Annotated[
        Preset,
        typer.Option(
            rich_help_panel=DETECT,
            metavar="PRESET",
            help="`default` finds the most; "
            "`report`, `report-2d` and `report-shape` are the chains of KS-09-9.",
        ),
    ],
    "settings": Annotated[
        Path | None,
        typer.Option(
            "--settings", rich_help_panel=DETECT, help="TOML file as `wayside settings` prints it."
        ),
    ],
    "assignments": Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            rich_help_panel=DETECT,
            metavar="GROUP.NAME=VALUE",
            help="Change one setting; may be repeated.",
        ),
    ],
    "detector": Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=DETECT,
            help="ONNX file of a YOLO or RT-DETR detector, instead of wayside's own.",
        ),
    ],
    "detections": Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=DETECT,
            help="Boxes made elsewhere, Parquet or COCO JSON, instead of wayside's own.",
        ),
    ],
    "classes": Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=DETECT,
            help="TOML: which classes of these are signs, and their colours and shapes.",
        ),
    ],
    "models": Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=DETECT,
            metavar="DIR",
            help="Model files of your own, as `wayside fit` writes them.",
        ),
    ],
    "alpha": Annotated[
        float | None,
        typer.Option(
            rich_help_panel=DETECT,
            help="False-alarm rate of every gate, instead of the thresholds of the models.",
        ),
    ],
    "route": Annotated[
        str | None,
        typer.Option(rich_help_panel=ROUTE, metavar="NAME", help='Route of the drive: "US-36 EB".'),
    ],
    "milepost": Annotated[
        str | None,
        typer.Option(
            rich_help_panel=ROUTE, help="Measure at the first used image: 12.35 (miles), 19.875km."
        ),
    ],
    "decreasing": Annotated[
        bool,
        typer.Option(
            "--decreasing", rich_help_panel=ROUTE, help="Mileposts fall in the direction of travel."
        ),
    ],
    "routes": Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=ROUTE,
            metavar="FILE",
            help="Route lines with measures (M), GeoPackage or GeoParquet; needs fixes.",
        ),
    ],
    "view": Annotated[
        ViewMode,
        typer.Option(
            rich_help_panel=VIEW,
            help="Record every step: `file` drive.rrd in the output folder, `live` a viewer's window, "
            "`serve` a viewer in the browser.",
        ),
    ],
    "connect": Annotated[
        str | None,
        typer.Option(
            rich_help_panel=VIEW,
            metavar="URL",
            help="Also send to a viewer that runs already: 127.0.0.1:9876.",
        ),
    ],
    "view_images": Annotated[
        RecordedImages,
        typer.Option(rich_help_panel=VIEW, help="Images to record: all, those with signs, none."),
    ],
    "view_detail": Annotated[
        bool,
        typer.Option(
            "--view-detail",
            rich_help_panel=VIEW,
            help="Presets of the report: also record the label images of both passes.",
        ),
    ],
}
"""Kind and words of each shared option."""
_DEFAULTS: dict[str, Any] = {
    "preset": Preset.default,
    "decreasing": False,
    "view": ViewMode.none,
    "view_images": RecordedImages.all,
    "view_detail": False,
}
_SETTINGS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "spacing": ("read.spacing_m", parse_spacing),
    "camera": ("read.camera", str),
    "calibration": ("read.calibration", str),
    "start": ("read.from_s", lambda text: parse_time(text, "--from")),
    "until": ("read.until_s", lambda text: parse_time(text, "--until")),
    "every": ("read.every", int),
    "workers": ("run.workers", int),
    "memory": ("run.memory_mb", parse_memory),
    "detector": ("models.detector", str),
    "detections": ("models.detections", str),
    "classes": ("models.classes", str),
    "models": ("models.folder", str),
    "alpha": ("models.alpha", float),
    "route": ("route.name", str),
    "decreasing": ("route.decreasing", bool),
    "routes": ("route.file", str),
}
"""The options that are settings by another name: that name, and what makes the value of the text."""


def takes(*names: str, heading: str | None = None) -> Callable[[Command], Command]:
    """Give a command shared options, which its parameter `given` (``**given``) holds by name.

    In the help they stand behind the arguments and options that must be given, under their own headings or `heading`.
    """

    def declared(command: Command) -> Command:
        *own, _ = inspect.signature(command, eval_str=True).parameters.values()
        shared = []
        for name in names:
            kind, option = get_args(_SHARED[name])
            option = copy.copy(option)
            option.rich_help_panel = heading or option.rich_help_panel
            shared.append(
                inspect.Parameter(
                    name,
                    inspect.Parameter.KEYWORD_ONLY,
                    default=_DEFAULTS.get(name),
                    annotation=Annotated[kind, option],
                )
            )
        needed = [one for one in own if one.default is one.empty]
        rest = [one for one in own if one.default is not one.empty]
        every = [
            one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in (*needed, *shared, *rest)
        ]
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
    options: dict[str, Any] = {}
    for name, (setting, parsed) in _SETTINGS.items():
        if given.get(name) is not None and given[name] is not False:
            options[setting] = parsed(given[name])
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
