"""The commands that make a log, say what one holds, and calibrate its camera. Heavy imports stand inside."""

import json
import math
import sys
from contextlib import ExitStack
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

from wayside.pipeline.cli.help import Application, examples, remark
from wayside.pipeline.cli.options import (
    Log,
    Option,
    Overwrite,
    chosen_settings,
    set_by,
    settings_of,
    takes,
)
from wayside.pipeline.cli.running import exit_with, read_as_log
from wayside.pipeline.files.lengths import parse_length
from wayside.pipeline.files.visible_text import counted, fitted, visible, visible_lines
from wayside.schemas.errors import PARTS_LOST, UsageError

app = Application("A drive")
Order = StrEnum("Order", {"by_name": "name", "by_date": "date"})
"""What decides the order of images, whatever contradicts it."""


def parse_date(text: str, option: str) -> datetime:
    """A date, or date and time, of ISO 8601; raises UsageError."""
    try:
        return datetime.fromisoformat(text)
    except ValueError as error:
        raise UsageError(
            f"{option}: {text!r} is not a date. Write 2009-05-14, or 2009-05-14T10:31+02:00."
        ) from error


@app.command(epilog=examples("wayside info drive.mcap", "wayside info drive.mcap --json"))
def info(
    log: Log,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what a log contains, and whether and how it can be used."""
    from wayside.pipeline.logs.information import format_log, inspect_log

    facts = inspect_log(read_as_log(log), shown=log)
    if as_json:
        typer.echo(json.dumps(facts, indent=1))
        return
    words = visible_lines(format_log(facts))
    typer.echo(fitted(words) if sys.stdout.isatty() else words)


HOW_TO_IMPORT = {
    "spacing": Option(
        str,
        "Distance between images, if they have no positions: 26.4ft, 8m.",
        "spacing_m",
        parsed=parse_length,
    ),
    "date": Option(
        str,
        "When the first image was taken: 2009-05-14, 2009-05-14T10:31Z.  [default: from Exif]",
        "date",
        parsed=parse_date,
    ),
    "positions": Option(
        Path, "GPX, or CSV with file or time, and lon, lat or route, milepost.  [default: Exif]"
    ),
    "routes": Option(Path, "Route lines with measures, for the mileposts of --positions."),
    "unit": Option(str, "Unit of those mileposts: mi, km, ft or m.", default="mi"),
    "every": Option(int, "Use every n-th image of a video.", default=1, least=1),
    "order": Option(Order, "Order to use if file names and capture dates disagree.", "order"),
}


@app.command(
    "import",
    epilog=examples(
        "wayside import images/*.jpg --calibration camera.yaml --spacing 26.4ft -o drive.mcap",
        "wayside import images/ --calibration camera.yaml --positions track.gpx -o drive.mcap",
        "wayside import dash.mp4 --every 5 --calibration camera.yaml --positions track.gpx -o drive.mcap",
    ),
)
@takes(own=HOW_TO_IMPORT)
def import_(
    images: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGES...", help="Numbered images, a folder, or a video (MP4)."),
    ],
    calibration: Annotated[
        Path, typer.Option(help="Camera calibration: YAML from ROS, OpenCV or Kalibr.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The log to write.")],
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Make a log from numbered images or a video, with positions if they are known."""
    from wayside.pipeline.cli.progress import SheetProgress
    from wayside.pipeline.logs.importing import ImportOptions, import_images
    from wayside.pipeline.logs.unpacking import VIDEOS, unpack_video
    from wayside.schemas.settings import RouteSettings

    how = ImportOptions(
        positions=given["positions"],
        routes=RouteSettings(file=str(given["routes"] or ""), unit=given["unit"]),
        overwrite=overwrite,
        **set_by(given, HOW_TO_IMPORT),
    )
    with ExitStack() as ended:
        progress = ended.enter_context(SheetProgress("import", "images"))
        for k, video in [(k, one) for k, one in enumerate(images) if one.suffix.lower() in VIDEOS]:
            images[k] = Path(ended.enter_context(TemporaryDirectory(prefix="wayside-")))
            unpack_video(
                video, images[k], every=given["every"], date=how.date, watch=progress.watch
            )
        done = import_images(
            images,
            calibration,
            out,
            how,
            warn=lambda words: remark(f"note: {words}"),
            watch=progress.watch,
        )
    begin = "; no date (add with --date)" if done.begin is None else f" from {done.begin}"
    placed = f", {done.placed} with a position" if done.placed else ""
    said = f"{out}: {counted(done.images, 'image')}{begin}{placed}; next: wayside run {out} -o out"
    typer.echo(visible(said))
    exit_with([PARTS_LOST] if done.left_out else [])


@app.command(
    epilog=examples(
        "wayside join bag/ -o drive.mcap",
        "wayside join day_0.mcap day_1.mcap -o day.mcap",
        "wayside join old.bag -o drive.mcap",
    )
)
def join(
    parts: Annotated[
        list[Path],
        typer.Argument(
            metavar="PART...", help="MCAP files in order, ROS 2 bag directories, ROS 1 bags."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The log to write.")],
    overwrite: Overwrite = False,
) -> None:
    """Make one log from the parts of a drive, or from a ROS bag."""
    from wayside.pipeline.logs.joining import join_logs

    joined = join_logs(parts, out, overwrite=overwrite)
    for words in joined.lost:
        remark(f"lost: {words}")
    of = f"{counted(joined.topics, 'topic')} of {counted(len(joined.parts), 'part')}"
    held = counted(joined.messages, "message")
    typer.echo(visible(f"{out}: {held} on {of}; next: wayside info {out}"))
    exit_with([PARTS_LOST] if joined.lost else [])


HOW_TO_CALIBRATE = {
    "out": Option(Path, "The ROS camera_info YAML to write.", names=("-o", "--out")),
    "board": Option(str, "Inner corners along both sides of the chessboard: 9x6."),
    "square": Option(str, "Side of a square: 25.4mm. Affects only the printed distances."),
    "model": Option(
        str,
        "Boards: plumb_bob (k1 k2 p1 p2), plumb_bob_k3 (and k3) or rational (and k4 k5 k6).  "
        "[default: plumb_bob]",
    ),
    "coverage": Option(
        Path, "Boards: image of the corners to write.  [default: next to the YAML, .coverage.png]"
    ),
    "name": Option(str, "Name of the camera in the YAML.", default="camera"),
}


@app.command(
    epilog=examples(
        "wayside calibrate boards/ --board 9x6 --square 25.4mm -o camera.yaml",
        "wayside calibrate drive.mcap -o camera.yaml",
        "wayside calibrate drive.mcap --calibration guess.yaml --from 1:30 --until 2:00",
    )
)
@takes(
    *("spacing", "camera", "calibration", "start", "until", "every", "settings", "assignments"),
    heading="For a log",
    own=HOW_TO_CALIBRATE,
)
def calibrate(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG|IMAGES...",
            help="The log of a drive. With --board: images of a chessboard, or a folder of them.",
        ),
    ],
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Calibrate a camera from a chessboard or from a drive: focal length and distortion with standard errors.

    Pass the result to `run`, `import` or `replay` as `--calibration camera.yaml`.
    """
    from wayside.pipeline.calibration.boards import parse_board
    from wayside.pipeline.calibration.command import calibrate_by_boards, calibrate_by_drive
    from wayside.pipeline.reading.parts import is_bag
    from wayside.pipeline.running.tuning import tune_process

    tune_process()
    chosen, board, square = chosen_settings(given), given["board"], given["square"]
    kept = {"name": given["name"], "out": given["out"], "overwrite": overwrite}
    if board is not None:
        if settings_of(given):
            raise UsageError(
                "--board takes images, which the options of a log (--spacing, --camera, --calibration, --from, "
                "--until, --every) do not apply to. Leave them out, or leave out --board."
            )
        square_m = math.nan if square is None else parse_length(square, "--square")
        how = {"model": given["model"] or "plumb_bob", "coverage": given["coverage"]} | kept
        typer.echo(visible_lines(calibrate_by_boards(paths, parse_board(board, square_m), **how)))
        return
    if folder := next((path for path in paths if path.is_dir() and not is_bag(path)), None):
        raise UsageError(
            f"{folder}: this is a folder, not a log. For images of a board, give its inner corners, as in --board "
            "9x6."
        )
    if any(given[name] is not None for name in ("square", "model", "coverage")):
        raise UsageError(
            "--square, --model and --coverage need --board. A board of 10 x 7 squares is --board 9x6."
        )
    if len(paths) != 1:
        raise UsageError(
            f"{len(paths)} logs are given, but only one can be calibrated at a time. Run the command for each, "
            "or give --board for images of a board."
        )
    typer.echo(visible_lines(calibrate_by_drive(paths[0], chosen, **kept)))
