"""Commands that show what a result rests on; registered by `wayside.pipeline.cli`. Heavy imports stand inside."""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayside.pipeline.cli_help import VIEW
from wayside.pipeline.visible_text import visible
from wayside.schemas.errors import PARTS_LOST, UsageError

if TYPE_CHECKING:
    from wayside.pipeline.view.sinks import Viewing


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


Out = Annotated[Path, typer.Argument(metavar="OUT", help="Folder written by `wayside run`.")]
ViewOption = Annotated[
    ViewMode,
    typer.Option(
        "--view",
        rich_help_panel=VIEW,
        help="Record every step: `file` drive.rrd in the output folder, `live` a viewer's window, "
        "`serve` a viewer in the browser.",
    ),
]
Connect = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=VIEW,
        metavar="URL",
        help="Also send to a viewer that runs already: 127.0.0.1:9876.",
    ),
]
ViewImages = Annotated[
    RecordedImages,
    typer.Option(
        "--view-images", rich_help_panel=VIEW, help="Images to record: all, those with signs, none."
    ),
]
ViewDetail = Annotated[
    bool,
    typer.Option(
        "--view-detail",
        rich_help_panel=VIEW,
        help="Presets of the report: also record the label images of both passes.",
    ),
]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace what stands there under the names of the output."),
]
Verbose = Annotated[
    bool,
    typer.Option(
        "-v", "--verbose", help="Also say what became of the regions, and the time of each stage."
    ),
]
Log = Annotated[
    Path, typer.Argument(metavar="LOG", help="An MCAP file, a ROS 2 bag directory, a ROS 1 bag.")
]
SignOption = Annotated[str | None, typer.Option("--sign", metavar="ID", help="A sign_id.")]
OverOption = Annotated[
    Path | None,
    typer.Option(
        "--over",
        metavar="LOG",
        help="Lay a recording without images over those of its log, which is imported once into OUT.",
    ),
]
FrameOption = Annotated[int | None, typer.Option("--frame", help="A frame of the log.")]


def viewing_of(
    view: ViewMode, connect: str | None, images: RecordedImages, detail: bool
) -> Viewing | None:
    """Start or probe the viewer that is asked for; None where nothing is to be recorded."""
    if view is ViewMode.none and connect is None:
        return None
    from wayside.pipeline.view.sinks import Viewing
    from wayside.pipeline.view.viewer import probe, start_viewer

    if connect is not None and view in (ViewMode.live, ViewMode.serve):
        raise UsageError(f"wanted one viewer, found --connect and --view {view}; leave one out")
    address = None if connect is None else probe(connect)
    if view in (ViewMode.live, ViewMode.serve):
        address = start_viewer(serve=view is ViewMode.serve)
    return Viewing(view is ViewMode.file, address, images.value, detail)


def leave_stuck_viewer(status: int) -> None:
    """End the program at once where a viewer that does not answer would hold the interpreter's own end for ever."""
    recorder = sys.modules.get("wayside.pipeline.view.recorder")
    if recorder is not None and recorder.any_alive():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def view(
    out: Out,
    sign: SignOption = None,
    frame: FrameOption = None,
    over: OverOption = None,
    serve: Annotated[bool, typer.Option(help="In the browser instead of a window.")] = False,
) -> None:
    """Open the recording of a run, at a sign or a frame."""
    from wayside.pipeline.view.results import find_target, open_result

    target = find_target(out, sign, frame)
    open_result(out, target, over, serve=serve)
    # a page opens at the start, whatever is asked for
    where = "go to it in the time panel: frame" if serve else "frame"
    typer.echo(visible(f"{out}: {where} {target.frame}"))


def picture(
    out: Out,
    png: Annotated[Path, typer.Option("-o", "--out", help="The PNG to write.")],
    sign: SignOption = None,
    frame: FrameOption = None,
    over: OverOption = None,
    size: Annotated[str, typer.Option(help="Width x height, pixels.")] = "1600x1000",
    overwrite: Overwrite = False,
) -> None:
    """Draw the viewer to a PNG without a display, at a sign or a frame."""
    from wayside.pipeline.view.results import find_target, save_screenshot

    target, pixels = find_target(out, sign, frame), _parse_size(size)
    save_screenshot(out, target, over, png, pixels, overwrite=overwrite)
    typer.echo(visible(f"{png}"))


def evidence(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder written by `wayside run`.")],
    sign: Annotated[
        str | None, typer.Option(metavar="ID", help="Only this sign, without an index.")
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="Where the log lies now, if it has moved since the run.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("-o", "--out", help="Where the sheets go; default: OUT/evidence.")
    ] = None,
    png: Annotated[
        bool, typer.Option("--png", help="Also write each sheet as an image, to print or send.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Write a page of images, maps and figures for every sign, and an index to filter and correct them."""
    from wayside.pipeline.evidence.write import write_evidence
    from wayside.pipeline.progress import SheetProgress
    from wayside.pipeline.tuning import tune_process

    tune_process()
    sheets = out / "evidence" if folder is None else folder
    if folder is None and sheets.is_symlink():
        raise UsageError(
            f"{sheets}: wanted a folder of its own, found a link; say with -o where the sheets go"
        )
    with SheetProgress("evidence") as progress:
        written = write_evidence(
            out,
            sheets,
            sign_id=sign,
            log=log,
            watch=progress.watch,
            png=png,
            overwrite=overwrite,
        )
    count = len(written.sheets)
    if written.index is not None:
        typer.echo(visible(f"{count} {'sheet' if count == 1 else 'sheets'}; open {written.index}"))
    else:
        typer.echo(visible(str(written.sheets[0])))
    if written.lost_views:
        typer.echo(
            f"wayside: {written.lost_views} views have no image: the log no longer holds it, or it does not decode; "
            "they are left empty on the sheets",
            err=True,
        )
        raise typer.Exit(PARTS_LOST)


def _parse_size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (
        width.isdecimal() and height.isdecimal() and 200 <= int(width) <= 8000 >= int(height) >= 200
    ):
        raise UsageError(f"--size {text}: wanted WIDTHxHEIGHT of 200 to 8000 pixels, as 1600x1000")
    return int(width), int(height)


def parse_rate(text: str) -> float | None:
    """`1x`, `0.5x` or a plain number as times the recorded speed; `max` as None.

    Raises
    ------
    UsageError
        For anything else.
    """
    if text == "max":
        return None
    try:
        rate = float(text.removesuffix("x"))
    except ValueError:
        rate = 0.0
    if not 0 < rate <= 1000:
        raise UsageError(f"--rate {text}: wanted 1x, 0.5x, 4x or max")
    return rate
