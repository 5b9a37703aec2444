"""The command `wayside calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

CALIBRATE_EPILOG = (
    "Examples: `wayside calibrate boards/ --board 9x6 --square 25.4mm -o camera.yaml`"
)


def calibrate(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGES...", help="Images of a chessboard, or a folder of them."),
    ],
    board: Annotated[
        str, typer.Option(help="Inner corners along both sides of the chessboard: 9x6.")
    ],
    square: Annotated[
        str | None,
        typer.Option(help="Side of a square: 25.4mm. Only the distances printed depend on it."),
    ] = None,
    model: Annotated[
        str,
        typer.Option(
            help="plumb_bob (k1 k2 p1 p2), plumb_bob_k3 (and k3) or rational (and k4 k5 k6)."
        ),
    ] = "plumb_bob",
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The ROS camera_info YAML to write.")
    ] = None,
    coverage: Annotated[
        Path | None,
        typer.Option(help="Picture of the corners.  [default: beside the YAML, .coverage.png]"),
    ] = None,
    name: Annotated[str, typer.Option(help="Name of the camera in the YAML.")] = "camera",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """Calibrate a camera: focal length and distortion with standard errors, as ROS camera_info YAML.

    `--calibration camera.yaml` of `run`, `import` and `replay` takes the result.
    """
    from math import nan

    from wayside.pipeline.calibration.boards import parse_board
    from wayside.pipeline.calibration.command import calibrate_by_boards
    from wayside.pipeline.lengths import parse_length
    from wayside.pipeline.tuning import tune_process

    tune_process()
    chessboard = parse_board(board, nan if square is None else parse_length(square))
    report = calibrate_by_boards(
        paths,
        chessboard,
        model=model,
        name=name,
        out=out,
        coverage=coverage,
        overwrite=overwrite,
    )
    typer.echo(report)
