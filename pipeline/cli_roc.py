"""The command that measures classifiers; registered by `wayside.pipeline.cli`. Heavy imports stand inside functions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline import cli_options as run_options
from wayside.pipeline.cli_help import examples
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
    preset: run_options.PresetOption = run_options.Preset.default,
    settings: run_options.SettingsFile = None,
    assignments: run_options.Assignments = None,
    spacing: run_options.Spacing = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure every classifier on labelled drives: true and false positives over thresholds, knee, area, confusion.

    What counts is what a classifier is really asked about. Bands are 95 % and resample whole drives; of one drive alone
    its stretches.
    """
    from wayside.pipeline.model_files import load_models
    from wayside.pipeline.roc.command import format_characteristics, measure_roc
    from wayside.pipeline.tuning import tune_process
    from wayside.pipeline.visible_text import visible_lines

    tune_process()
    options = run_options.read_options(spacing, None, None, None, None, None, None)
    chosen = run_options.chosen_settings(preset, settings, assignments, options)

    def notify(line: str) -> None:
        typer.echo(visible_lines(line), err=True)

    models = load_models(chosen)
    measured = measure_roc(logs, labels, out, chosen, models, notify, overwrite=overwrite)
    typer.echo(visible_lines(format_characteristics(measured)))
