"""The commands that run one log or several: progress, summary, exit status. Heavy imports stand inside."""

import gc
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayside.pipeline.cli.help import DETECT, READ, Application, examples, remark
from wayside.pipeline.cli.options import Log, Overwrite, ViewMode, chosen_settings, flag, takes
from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.running.process import in_words, report_error
from wayside.schemas.errors import (
    PARTS_LOST,
    InputError,
    InterruptionError,
    OutputError,
    StageError,
    UsageError,
    WaysideError,
)

if TYPE_CHECKING:
    from wayside.pipeline.view.observer import Viewing
    from wayside.schemas.settings import Settings

app = Application("A drive")
EXIT_STATUSES = """Exit status:

- 0 done
- 1 an internal error
- 2 wrong arguments or settings
- 3 the input cannot be used
- 4 done, but parts of the input were lost
- 5 the output could not be written, or already exists
- 130 interrupted"""
"""For the help."""
_GRAVEST = (
    StageError.exit_status,
    OutputError.exit_status,
    InputError.exit_status,
    UsageError.exit_status,
    PARTS_LOST,
)
_SHOWN = ("serve", "port", "connect", "view_images", "view_detail")
_DETECTORS = ("detector", "detections", "classes", "models")


SELF_CALIBRATE = flag(
    "--self-calibrate",
    "Calibrate the camera from the drive first, like `wayside calibrate LOG`. Writes camera.yaml to the output folder.",
    panel=READ,
)
Listed = StrEnum("Listed", ["passed", "all"])
"""Which regions become rows of observations.parquet."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Arguments of `run_log` besides the settings, whether its result is kept, and what is printed."""

    every_region: bool = False
    rate: float | None = None
    kept: bool = True
    overwrite: bool = False
    resume: bool = False
    verbose: bool = False
    self_calibrate: bool = False


@app.command(
    epilog=examples(
        "wayside run drive.mcap -o out",
        "wayside run images.mcap --spacing 26.4ft -o out",
        "wayside run drive.mcap --camera /front/image --from 1:30 --until 2:00 -o out",
        "wayside run drive.mcap --view file -o out",
        "wayside run drive.mcap --route 'US-36 EB' --milepost 12.35 -o out",
        "wayside run drive.mcap --detector yolo.onnx --classes classes.toml -o out",
        "wayside run drive.mcap --preset report --set segment.clusters=12 -o out",
    )
    + "\n\n"
    + EXIT_STATUSES
)
@takes(
    *("spacing", "camera", "calibration", "start", "until", "every", "workers", "memory"),
    *("preset", "settings", "assignments", *_DETECTORS, "alpha"),
    *("roadside", "route", "milepost", "decreasing", "routes", "view", "blur", *_SHOWN),
    own={"self_calibrate": SELF_CALIBRATE},
)
def run(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...", help="MCAP files, ROS 2 bag directories, ROS 1 bags."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", help="Output folder. With several logs, it gets one folder per log."
        ),
    ],
    observations: Annotated[
        Listed,
        typer.Option(
            rich_help_panel=DETECT,
            help="Regions to list: those that are classified, or all that pass the size gate.",
        ),
    ] = Listed.passed,
    overwrite: Overwrite = False,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Save the progress of each image. Continue where the same command stopped.",
        ),
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "-v",
            "--verbose",
            help="Also print how many regions were kept or rejected, and the time of each stage.",
        ),
    ] = False,
    **given: Any,
) -> None:
    """Find the signs of a drive and write them to a folder of Parquet tables."""
    if resume and (given["view"] is not ViewMode.none or given["connect"] or given["serve"]):
        raise UsageError(
            "--resume does not work with a viewer, which would miss images. Leave one out."
        )
    for option in ("milepost", "detections"):
        if given[option] is not None and len(logs) > 1:
            raise UsageError(
                f"--{option}: {len(logs)} logs are given, but this option applies to one log. Run each log by itself."
            )
    settings, viewing = chosen_settings(given), viewing_of(given["view"], given)
    folders = [out if len(logs) == 1 else out / log.stem for log in logs]
    how = RunOptions(
        observations is Listed.all,
        overwrite=overwrite,
        resume=resume,
        verbose=verbose,
        self_calibrate=given["self_calibrate"],
    )
    process_all(logs, folders, settings, viewing, how)


@app.command(
    epilog=examples(
        "wayside replay drive.mcap", "wayside replay drive.mcap --rate max --connect 127.0.0.1:9876"
    )
)
@takes(
    *("spacing", "camera", "calibration", "start", "until", "workers"),
    *("preset", "settings", "assignments", *_DETECTORS, *_SHOWN),
)
def replay(
    log: Log,
    rate: Annotated[str, typer.Option(help="Playback speed: 1x, 0.5x, or max.")] = "1x",
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also write the result to this folder.")
    ] = None,
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Process a log at its recorded speed and show every step in a live viewer."""
    settings, times = chosen_settings(given), parse_rate(rate)
    viewing = viewing_of(ViewMode.live if given["connect"] is None else ViewMode.none, given)
    how = RunOptions(rate=times, kept=out is not None, overwrite=overwrite)
    with tempfile.TemporaryDirectory(prefix="wayside-") as scratch:
        folder = Path(scratch) if out is None else out
        end = process(read_as_log(log), folder, settings, viewing, how)
    exit_with([end])


def viewing_of(view: ViewMode, given: Mapping[str, Any]) -> "Viewing | None":
    """Start or probe the viewer that is asked for; None where nothing is to be recorded."""
    connect, serve, port = given["connect"], given["serve"], given["port"]
    require_page(serve, port)
    if view is ViewMode.none and connect is None and not serve:
        return None
    from wayside.pipeline.view.observer import Viewing
    from wayside.pipeline.view.viewer import probe, start_viewer

    if connect is not None and (serve or view is ViewMode.live):
        other = "--serve" if serve else "--view live"
        raise UsageError(f"--connect and {other} each name a viewer. Leave one out.")
    address = None if connect is None else probe(connect)
    if serve or view is ViewMode.live:
        address = start_viewer(serve=serve, web_port=port)
    images, detail = given["view_images"].value, given["view_detail"]
    blur = given.get("blur", False)
    if blur and detail:
        raise UsageError("--blur: the images of --view-detail cannot be blurred. Leave one out.")
    return Viewing(view is ViewMode.file, address, images, detail, blur)


def require_page(serve: bool, port: int | None) -> None:
    """Raise UsageError for a port of a page that is not asked for."""
    if port is not None and not serve:
        raise UsageError(
            "--port is the port of the page of --serve. Add --serve, or leave --port out."
        )


def parse_rate(text: str) -> float | None:
    """`1x`, `0.5x` or a plain number as times the recorded speed, `max` as None. Raises UsageError."""
    if text == "max":
        return None
    try:
        rate = float(text.removesuffix("x"))
    except ValueError:
        rate = 0.0
    if not 0 < rate <= 1000:
        raise UsageError(f"--rate {text}: this is not a rate. Write 1x, 0.5x, 4x or max.")
    return rate


def process_all(
    logs: Sequence[Path],
    folders: Sequence[Path],
    settings: "Settings",
    viewing: "Viewing | None",
    how: RunOptions,
) -> None:
    """Run logs one after the other and end with the gravest status.

    With several logs, all output folders are checked before the first is run. A log that cannot be run is reported, and
    the others are run. A log whose result exists already, from the same log, settings and models, is skipped. It is not
    skipped with `overwrite` or with a viewer.

    Raises UsageError where two logs would be written to one folder. Raises OutputError where another file is in the
    place of a result, and InterruptionError where somebody ended the work on all logs.
    """
    if len(logs) == 1:
        exit_with([process(read_as_log(logs[0]), folders[0], settings, viewing, how)])
        return
    from wayside.pipeline.models.model_files import load_models

    _check_places(logs, folders, overwrite=how.overwrite)
    digests = load_models(settings).digests()
    ends: list[tuple[int, str]] = []
    for number, (log, folder) in enumerate(zip(logs, folders, strict=True), 1):
        typer.echo(visible(f"log {number} of {len(logs)}: {log}"))
        try:
            ends.append(_one_of_several(log, folder, settings, viewing, how, digests))
        except InterruptionError:
            raise
        except (WaysideError, OSError) as error:
            told = in_words(error) if isinstance(error, OSError) else error
            status = report_error(told, debug="--debug" in sys.argv[1:])
            ends.append((status, "failed"))
    typer.echo("")
    for log, (status, words) in zip(logs, ends, strict=True):
        typer.echo(visible(f"{log}: {words}{f', exit status {status}' if status else ''}"))
    exit_with([status for status, _ in ends])


def _one_of_several(
    log: Path,
    folder: Path,
    settings: "Settings",
    viewing: "Viewing | None",
    how: RunOptions,
    digests: dict[str, str],
) -> tuple[int, str]:
    """Run a log unless its result is there; its status, and what became of it in words."""
    from wayside.pipeline.results.result import is_finished
    from wayside.pipeline.running.journal import result_key

    source = read_as_log(log)
    asked = {"every_region": how.every_region, "self_calibrate": how.self_calibrate}
    key = result_key(source, settings, digests, **asked)
    if viewing is None and not how.overwrite and is_finished(folder, key):
        return 0, f"unchanged, kept the result in {folder}"
    return process(source, folder, settings, viewing, how), f"done, result in {folder}"


def _check_places(logs: Sequence[Path], folders: Sequence[Path], *, overwrite: bool) -> None:
    """Look at all places of results; raises as `process_all`."""
    from wayside.pipeline.files.output_folder import finish_replacement
    from wayside.pipeline.logs.joining import joined_log
    from wayside.pipeline.results.result import check_earlier

    twice = next((folder for folder in folders if list(folders).count(folder) > 1), None)
    if twice is not None:
        raise UsageError(
            f"two logs are named {twice}, but each result folder is named after its log. Run them one at a time."
        )
    for log, folder in zip(logs, folders, strict=True):
        finish_replacement(folder)
        with suppress(InputError, OSError):  # of the log: told when it is its turn
            source = joined_log(log) or log
            if source == log or source.exists():  # else a bag that is not joined yet
                check_earlier(folder, source, overwrite=overwrite)


def read_as_log(path: Path) -> Path:
    """What is to be read of a recording; says on stderr where the log of a ROS bag lies. Raises as `readable_log`."""
    from wayside.pipeline.logs.joining import readable_log

    return readable_log(path, remark)


def process(
    log: Path,
    folder: Path,
    settings: "Settings",
    viewing: "Viewing | None" = None,
    how: RunOptions | None = None,
) -> int:
    """Run one log with progress and a closing summary; the exit status that it asks for."""
    gc.disable()  # half a million objects of modules, which stay: searches among them take 0.1 s
    from rich.console import Console

    from wayside.pipeline.calibration.command import self_calibrated
    from wayside.pipeline.cli.progress import FrameProgress
    from wayside.pipeline.cli.summary import print_summary
    from wayside.pipeline.models.model_files import load_models
    from wayside.pipeline.reading.frames import ReadReport
    from wayside.pipeline.running.compilation import watched_compilation
    from wayside.pipeline.running.run import Run, RunObserver, RunRequest, run_log
    from wayside.pipeline.running.tuning import tune_process

    how = how or RunOptions()
    tune_process()
    gc.enable()
    models = load_models(settings)

    def open_observer(report: ReadReport, part: Path) -> RunObserver | None:
        if viewing is None:
            return None
        from wayside.pipeline.view.observer import open_observer

        return open_observer(viewing, part, visible(log.stem), models.location_classes, report)

    rest = sys.argv[1:], how.every_region, open_observer, how.rate, how.overwrite, how.resume
    calibrate = partial(self_calibrated, overwrite=how.overwrite) if how.self_calibrate else None
    asked, under_way = RunRequest(log, folder, settings, models, *rest, calibrate), Run()
    try:
        with (
            FrameProgress(log.name, under_way) as progress,
            watched_compilation(progress.compiling),
        ):
            result = run_log(asked, under_way)
    except KeyboardInterrupt as error:
        done = "were" if under_way.result else "were not"
        more = "; run it again to continue" if how.resume and not under_way.result else ""
        raise InterruptionError(f"interrupted; this log's tables {done} written{more}") from error
    seen = sys.stdout.isatty()  # a pipe gets each statement as one line
    console = Console(highlight=False, soft_wrap=not seen, width=None if seen else 160)
    print_summary(result, console, kept=how.kept, verbose=how.verbose)
    if result.recorded is False:
        return OutputError.exit_status
    return PARTS_LOST if result.lost else 0


def exit_with(statuses: list[int]) -> None:
    """End with the gravest of the statuses: what is not done at all, then parts that are lost."""
    for status in _GRAVEST:
        if status in statuses:
            raise typer.Exit(status)


def leave_stuck_viewer(status: int) -> None:
    """End the program at once where a viewer that does not answer would hold the interpreter's own end for ever."""
    recorder = sys.modules.get("wayside.pipeline.view.observer")
    if recorder is not None and recorder.any_alive():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
