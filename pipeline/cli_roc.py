"""The command that measures classifiers; registered by `wayside.pipeline.cli`. Heavy imports stand inside functions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline.cli_help import examples
from wayside.pipeline.cli_options import read_options
from wayside.pipeline.cli_viewing import Overwrite

ROC_EPILOG = examples(
    "wayside roc drive.mcap --truth drive.truth.json -o roc",
    "wayside roc a.mcap b.mcap --labels labels.parquet --preset report -o roc",
)


def roc(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="MCAP files.")],
    labels: Annotated[
        list[Path],
        typer.Option(
            "--labels",
            "--truth",
            help="Labels of their images, of any format; may be repeated (docs/labels.md).",
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Output folder.")],
    preset: Annotated[str, typer.Option(help="Whose classifiers.")] = "default",
    settings: Annotated[
        Path | None,
        typer.Option("--settings", help="TOML file as `wayside settings` prints it."),
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="GROUP.NAME=VALUE", help="Change one setting."),
    ] = None,
    spacing: Annotated[
        str | None, typer.Option(help="Distance between images, where the logs have no poses.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure every classifier on labelled drives: true and false positives over thresholds, knee, area, confusion.

    What counts is what a classifier is really asked about. Bands are 95 % and resample whole drives; of one drive alone
    its stretches.
    """
    from wayside.pipeline.model_files import load_models
    from wayside.pipeline.roc.command import format_characteristics, measure_roc
    from wayside.pipeline.settings_file import load_settings
    from wayside.pipeline.tuning import tune_process
    from wayside.pipeline.visible_text import visible_lines

    tune_process()
    options = read_options(spacing, None, None, None, None, None, None)
    chosen = load_settings(preset, settings, assignments or [], options)[0]
    measured = measure_roc(
        logs,
        labels,
        out,
        chosen,
        load_models(chosen),
        lambda line: typer.echo(visible_lines(line), err=True),
        overwrite=overwrite,
    )
    typer.echo(visible_lines(format_characteristics(measured)))
