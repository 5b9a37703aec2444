"""The command `wayside report-figures`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline import cli_options as run_options
from wayside.pipeline.cli_help import examples
from wayside.pipeline.cli_viewing import Overwrite
from wayside.pipeline.visible_text import visible

REPORT_FIGURES_EPILOG = examples(
    "wayside report-figures drive.mcap -o figures",
    "wayside report-figures drive.mcap --spacing 26.4ft -o figures",
    "wayside report-figures drive.mcap --labels labels.parquet --boards boards/ --board 9x6 -o figures",
)


def report_figures(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The log of a drive.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of report_figures.html.")],
    labels: Annotated[
        Path | None,
        typer.Option(
            help="Labels of its images; see docs/labels.md.  "
            "[default: LOG.truth.json, LOG.labels.json or LOG.labels.parquet beside it]"
        ),
    ] = None,
    boards: Annotated[
        Path | None, typer.Option(help="Folder with images of a chessboard, for figure 6.1.")
    ] = None,
    board: Annotated[
        str | None, typer.Option(help="Inner corners along both sides of the chessboard: 9x6.")
    ] = None,
    spacing: run_options.Spacing = None,
    camera: run_options.CameraTopic = None,
    calibration: run_options.Calibration = None,
    assignments: run_options.Assignments = None,
    overwrite: Overwrite = False,
) -> None:
    """Make the figures of the report KS-09-9 on a drive, each number beside the report's, as one page."""
    from wayside.pipeline.report_figures.command import write_figures
    from wayside.pipeline.tuning import tune_process
    from wayside.schemas.errors import UsageError

    if (boards is None) != (board is None):
        raise UsageError(
            "wanted --boards and --board together, found one of them; a board of 10 x 7 squares is --board 9x6"
        )
    tune_process()
    page, figures = write_figures(
        log,
        out,
        labels=labels,
        boards=None if boards is None else [boards],
        board=board,
        assignments=assignments,
        options=run_options.read_options(spacing, camera, calibration, None, None, None, None),
        overwrite=overwrite,
    )
    left_out = [figure.number for figure in figures if figure.needs]
    words = f"; left out: {', '.join(left_out)}" if left_out else ""
    typer.echo(visible(f"{page}: {len(figures) - len(left_out)} figures{words}"))
