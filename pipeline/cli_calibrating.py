"""The command `wayside calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline.cli_help import examples
from wayside.pipeline.cli_options import read_options
from wayside.pipeline.visible_text import visible_lines

CALIBRATE_EPILOG = examples(
    "wayside calibrate boards/ --board 9x6 --square 25.4mm -o camera.yaml",
    "wayside calibrate drive.mcap -o camera.yaml",
    "wayside calibrate drive.mcap --calibration guess.yaml --from 1:30 --until 2:00",
)


def calibrate(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG|IMAGES...",
            help="The log of a drive; with --board images of a chessboard, or a folder of them.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The ROS camera_info YAML to write.")
    ] = None,
    board: Annotated[
        str | None, typer.Option(help="Inner corners along both sides of the chessboard: 9x6.")
    ] = None,
    square: Annotated[
        str | None,
        typer.Option(help="Side of a square: 25.4mm. Only the distances printed depend on it."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="Boards: plumb_bob (k1 k2 p1 p2), plumb_bob_k3 (and k3) or rational (and k4 k5 k6).  "
            "[default: plumb_bob]"
        ),
    ] = None,
    coverage: Annotated[
        Path | None,
        typer.Option(
            help="Boards: picture of the corners.  [default: beside the YAML, .coverage.png]"
        ),
    ] = None,
    spacing: Annotated[
        str | None, typer.Option(help="Log: distance between images, as of `run`; may be missing.")
    ] = None,
    camera: Annotated[
        str | None, typer.Option(help="Log: image topic, where it has several.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Log: YAML of ROS, OpenCV or Kalibr to start from.")
    ] = None,
    start: Annotated[
        str | None, typer.Option("--from", help="Log: start here, 90s or 1:30.")
    ] = None,
    until: Annotated[str | None, typer.Option(help="Log: stop here.")] = None,
    every: Annotated[int | None, typer.Option(help="Log: use every n-th image.")] = None,
    name: Annotated[str, typer.Option(help="Name of the camera in the YAML.")] = "camera",
    settings: Annotated[
        Path | None,
        typer.Option("--settings", help="TOML file as `wayside settings` prints it."),
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="GROUP.NAME=VALUE", help="Change one setting."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """Calibrate a camera by a chessboard or by a drive: focal length and distortion with standard errors.

    `--calibration camera.yaml` of `run`, `import` and `replay` takes the result.
    """
    from math import nan

    from wayside.pipeline.calibration.boards import parse_board
    from wayside.pipeline.calibration.command import calibrate_by_boards, calibrate_by_drive
    from wayside.pipeline.lengths import parse_length
    from wayside.pipeline.reading.parts import is_bag
    from wayside.pipeline.settings_file import load_settings
    from wayside.pipeline.tuning import tune_process
    from wayside.schemas.errors import UsageError

    tune_process()
    options = read_options(spacing, camera, calibration, start, until, every, None)
    chosen = load_settings("default", settings, assignments or [], options)[0]
    if board is None and (folder := next((p for p in paths if p.is_dir() and not is_bag(p)), None)):
        raise UsageError(
            f"{folder}: wanted a log, found a folder; of images of a board say the inner corners, as in --board 9x6"
        )
    if board is not None:
        if options:
            raise UsageError(
                "wanted images of a board, found options of a log (--spacing, --camera, --calibration, --from, "
                "--until, --every); leave them out, or leave out --board"
            )
        square_m = nan if square is None else parse_length(square, "--square")
        report = calibrate_by_boards(
            paths,
            parse_board(board, square_m),
            model=model or "plumb_bob",
            name=name,
            out=out,
            coverage=coverage,
            overwrite=overwrite,
        )
    else:
        if square is not None or model is not None or coverage is not None:
            raise UsageError(
                "wanted --board for --square, --model and --coverage, found none; a board of 10 x 7 squares is "
                "--board 9x6"
            )
        if len(paths) != 1:
            raise UsageError(
                f"wanted one log, found {len(paths)}; calibrate each by itself, or give --board for images of a board"
            )
        report = calibrate_by_drive(paths[0], chosen, name=name, out=out, overwrite=overwrite)
    typer.echo(visible_lines(report))
