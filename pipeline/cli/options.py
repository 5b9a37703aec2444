"""Options that several commands share, and the settings that they make."""

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayside.pipeline.cli.help import DETECT, READ, ROUTE, VIEW
from wayside.pipeline.files.lengths import parse_length, parse_memory, parse_time
from wayside.schemas.errors import UsageError

if TYPE_CHECKING:
    from wayside.schemas.settings import RouteSettings, Settings

Command = Callable[..., None]
_MEASURE = re.compile(r"(\d+\.?\d*|\.\d+)\s*([a-z]*)")


Preset = StrEnum("Preset", ["default", "report-shape", "report-2d", "report"])
"""Which chain of stages."""
ViewMode = StrEnum("ViewMode", ["none", "file", "live"])
"""Where a run's recording goes."""
RecordedImages = StrEnum("RecordedImages", ["all", "signs", "none"])
"""Which images a recording holds."""
Lengths = StrEnum("Lengths", ["metric", "us"])
"""Units of lengths."""
Log = Annotated[
    Path, typer.Argument(metavar="LOG", help="An MCAP file, a ROS 2 bag directory or a ROS 1 bag.")
]
Out = Annotated[Path, typer.Argument(metavar="OUT", help="Folder written by `wayside run`.")]
MovedLog = Annotated[
    Path | None, typer.Option(help="Where the log is now, if it has moved since the run.")
]
ReviewFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--review",
        help="Corrections saved from the evidence index, also of an earlier run. Repeat to merge several.  "
        "[default: review*.json, review*.csv in OUT]",
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing output files.")]


@dataclass(frozen=True, slots=True)
class Option:
    """An option that several commands share, or one of the many of a command."""

    kind: Any
    """Type of its value; None may stand for it where there is no default."""
    help: str
    sets: str = ""
    """The setting, or field, that it is by another name."""
    default: Any = None
    parsed: Callable[[str, str], Any] | None = None
    """Makes the value of a text and the option's name. None: it is as given, a path as text."""
    names: tuple[str, ...] = ()
    least: int | None = None
    """Of a number, as `most`."""
    most: int | None = None
    metavar: str | None = None
    panel: str | None = None
    """Heading in the help. None: that of the setting."""

    def flag(self, name: str) -> str:
        """How it is written on the command line."""
        return self.names[0] if self.names else f"--{name.replace('_', '-')}"

    def parameter(self, name: str, heading: str | None = None) -> inspect.Parameter:
        """As a parameter of a command."""
        panel = heading or self.panel or _HEADINGS.get(self.sets.partition(".")[0])
        option = typer.Option(
            *self.names,
            help=self.help,
            rich_help_panel=panel,
            metavar=self.metavar,
            min=self.least,
            max=self.most,
        )
        kind = self.kind if self.default is not None else self.kind | None
        return inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=self.default,
            annotation=Annotated[kind, option],
        )

    def value(self, given: Any, option: str) -> Any:
        """What the setting or field becomes; raises UsageError for what cannot be parsed."""
        if self.parsed is not None:
            return self.parsed(given, option)
        return str(given) if isinstance(given, Path) else given


def flag(name: str, words: str, sets: str = "", panel: str | None = None) -> Option:
    """An option without a value."""
    return Option(bool, words, sets, default=False, names=(name,), panel=panel)


_HEADINGS = {"read": READ, "models": DETECT, "route": ROUTE}
SHARED = {
    "spacing": Option(
        str,
        "Distance between images, if the log has no poses: 26.4ft, 8m.",
        "read.spacing_m",
        parsed=parse_length,
    ),
    "camera": Option(str, "Image topic, if the log has several.", "read.camera"),
    "calibration": Option(
        Path, "Calibration YAML (ROS, OpenCV, Kalibr) in place of the log's.", "read.calibration"
    ),
    "start": Option(
        str, "Start at this time: 90s or 1:30.", "read.from_s", parsed=parse_time, names=("--from",)
    ),
    "until": Option(str, "Stop at this time: 120s or 2:00.", "read.until_s", parsed=parse_time),
    "every": Option(int, "Use every n-th image.", "read.every"),
    "workers": Option(int, "Number of images processed in parallel.", "run.workers"),
    "memory": Option(
        str, "Memory limit for images in progress: 2GB.", "run.memory_mb", parsed=parse_memory
    ),
    "preset": Option(
        Preset,
        "`default` finds the most signs; `report`, `report-2d` and `report-shape` follow report KS-09-9.",
        default=Preset.default,
        metavar="PRESET",
        panel=DETECT,
    ),
    "settings": Option(Path, "TOML file, as printed by `wayside settings`.", panel=DETECT),
    "assignments": Option(
        list[str],
        "Change one setting. Repeat for several.",
        names=("--set",),
        metavar="GROUP.NAME=VALUE",
        panel=DETECT,
    ),
    "detector": Option(
        Path,
        "ONNX file of a YOLO or RT-DETR detector to use instead of wayside's own.",
        "models.detector",
    ),
    "detections": Option(
        Path,
        "Boxes from another tool (Parquet or COCO JSON) to use instead of wayside's own.",
        "models.detections",
    ),
    "classes": Option(
        Path,
        "TOML file: which classes of these boxes are signs, and their colours and shapes.",
        "models.classes",
    ),
    "models": Option(
        Path,
        "Folder of your own model files, as written by `wayside fit`.",
        "models.folder",
        metavar="DIR",
    ),
    "alpha": Option(
        str,
        "False-alarm rate for every gate, or for some (color=0.1,location=0.05). Replaces the models' thresholds.",
        "models.alpha",
        metavar="RATE",
    ),
    "roadside": flag(
        "--roadside",
        "Also measure the roadside. Writes profile.parquet, sections.parquet and posts.parquet.",
        "roadside.on",
        panel=ROUTE,
    ),
    "route": Option(str, 'Route of the drive: "US-36 EB".', "route.name", metavar="NAME"),
    "milepost": Option(
        str, "Milepost at the first used image: 12.35 (miles), 19.875km.", panel=ROUTE
    ),
    "decreasing": flag(
        "--decreasing", "Mileposts decrease in the direction of travel.", "route.decreasing"
    ),
    "routes": Option(
        Path,
        "Route lines with measures (M): GeoPackage or GeoParquet. The log needs satellite fixes.",
        "route.file",
        metavar="FILE",
    ),
    "units": Option(
        Lengths, "`us`: distances in feet, sign sizes in inches.", default=Lengths.metric
    ),
    "view": Option(
        ViewMode,
        "Record every step: `file` writes drive.rrd to the output folder, `live` opens a viewer.",
        default=ViewMode.none,
        panel=VIEW,
    ),
    "serve": flag("--serve", "Show the viewer in a browser instead of a window.", panel=VIEW),
    "port": Option(
        int, "Port for --serve.  [default: any free port]", least=1, most=65535, panel=VIEW
    ),
    "connect": Option(
        str, "Also send to a running viewer: 127.0.0.1:9876.", metavar="URL", panel=VIEW
    ),
    "view_images": Option(
        RecordedImages,
        "Images to record: all, only those with signs, or none.",
        default=RecordedImages.all,
        panel=VIEW,
    ),
    "blur": flag(
        "--blur", "Blur all but the sign panels in stored images.", "read.blur", panel=VIEW
    ),
    "view_detail": flag(
        "--view-detail",
        "Report presets: also record the label images of both segmentation passes.",
        panel=VIEW,
    ),
}
"""Options that several commands share."""


def takes(
    *names: str, heading: str | None = None, own: Mapping[str, Option] | None = None
) -> Callable[[Command], Command]:
    """Give a command shared options, then those of a table of its own; its ``**given`` holds them by name.

    In the help they stand behind the arguments and options that must be given. Shared ones stand under their own
    headings, or `heading`.
    """

    def declared(command: Command) -> Command:
        *typed, _ = inspect.signature(command, eval_str=True).parameters.values()
        typed = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in typed]
        needed = [one for one in typed if one.default is one.empty]
        shared = [SHARED[name].parameter(name, heading) for name in names]
        listed = [option.parameter(name) for name, option in (own or {}).items()]
        every = [*needed, *shared, *listed, *(one for one in typed if one not in needed)]
        command.__signature__ = inspect.Signature(every)  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in every}
        return command

    return declared


def set_by(given: Mapping[str, Any], options: Mapping[str, Option]) -> dict[str, Any]:
    """Values of settings or fields by their names, from the options that are given; raises UsageError."""
    return {
        options[name].sets: options[name].value(value, options[name].flag(name))
        for name, value in given.items()
        if value is not None and value is not False and name in options and options[name].sets
    }


def settings_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are settings by another name, by that name, those given only; raises UsageError."""
    milepost = given.get("milepost")
    return set_by(given, SHARED) | ({} if milepost is None else parse_milepost(milepost))


def chosen_settings(given: Mapping[str, Any]) -> "Settings":
    """Settings of a preset, a file, `--set` and options, later ones win; raises UsageError."""
    from wayside.pipeline.files.settings_file import load_settings

    preset, file = given.get("preset", Preset.default), given.get("settings")
    options = settings_of(given)
    return load_settings(preset.value, file, given.get("assignments") or [], options)[0]


def route_of(given: Mapping[str, Any]) -> "RouteSettings | None":
    """The route that is given for a result, None where none is; raises UsageError."""
    return chosen_settings(given).route if settings_of(given) else None


def parse_milepost(text: str) -> dict[str, Any]:
    """Measure and unit of a milepost as settings: "12.35" and "12.35mi" are miles, "19.875km" kilometres.

    Raises UsageError where the text is no milepost.
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
