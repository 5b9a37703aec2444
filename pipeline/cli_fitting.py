"""The command `wayside fit`, and the option of a run that takes its result."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from wayside.pipeline import cli_options as run_options
from wayside.pipeline.cli_help import DETECT, examples
from wayside.schemas.errors import UsageError

FIT_EPILOG = examples(
    "wayside fit labels.parquet --images drive.mcap -o my_models",
    "wayside fit coco.json --classes classes.toml --images pictures/ --complete -o my_models",
    "wayside fit labels.parquet --images a.mcap --images b.mcap --alpha 0.01 -o my_models",
    "wayside run drive.mcap --models my_models -o out",
)


Fitted = StrEnum("Fitted", ["color", "shape", "location", "confidence"])
"""What can be fitted."""
Space = Literal["auto", "rgb", "chromaticity", "log_chromaticity", "log_rgb", "lab"]
"""Spaces of the colour classes."""

Models = Annotated[
    Path | None,
    typer.Option(
        "--models",
        rich_help_panel=DETECT,
        metavar="DIR",
        help="Model files of your own, as `wayside fit` writes them.",
    ),
]


def model_options(models: Path | None) -> dict[str, Any]:
    """The option as a setting, where it is given."""
    return {} if models is None else {"models.folder": str(models)}


def fit(
    labels: Annotated[
        list[Path],
        typer.Argument(
            metavar="LABELS...",
            help="Labels: wayside's Parquet, COCO, YOLO, VOC, the truth of a drive, or a reviewed result. One, or one "
            "for each --images.",
        ),
    ],
    images: Annotated[
        list[Path],
        typer.Option("--images", metavar="LOG|DIR", help="What is labelled; may be repeated."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the models.")],
    model: Annotated[
        list[Fitted] | None, typer.Option("--model", help="Fit this model only; may be repeated.")
    ] = None,
    alpha: Annotated[
        float | None,
        typer.Option(help="False-alarm rate of each gate, 0.01 for instance.  [default: the knee]"),
    ] = None,
    space: Annotated[
        Space, typer.Option(help="Space of the colours; auto: by cross-validation.")
    ] = "auto",
    complete: Annotated[
        bool, typer.Option("--complete", help="Every sign of the labelled images is labelled.")
    ] = False,
    only_labelled: Annotated[
        bool,
        typer.Option(
            "--only-labelled",
            help="Leave out classes with too few labelled signs instead of keeping the shipped ones.",
        ),
    ] = False,
    classes: Annotated[
        Path | None, typer.Option(help="TOML: which classes of COCO, YOLO, VOC are which signs.")
    ] = None,
    source: Annotated[str, typer.Option(help="Who made images and labels, for the models.")] = "",
    licence: Annotated[str, typer.Option(help="Licence of the images, for the models.")] = "",
    spacing: run_options.Spacing = None,
    camera: run_options.CameraTopic = None,
    calibration: run_options.Calibration = None,
    start: run_options.From = None,
    until: run_options.Until = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """Fit colours, shapes, location and confidence to your own labels.

    Writes model files that `wayside run --models` takes, with counts, thresholds and what was held out; labels of 50
    images are enough for colours that stand on five signs each.
    """
    from wayside.pipeline.fitting.command import FitOptions, fit_labels
    from wayside.pipeline.tuning import tune_process
    from wayside.pipeline.visible_text import visible, visible_lines

    if alpha is not None and not 0 < alpha < 1:
        raise UsageError(f"--alpha: wanted a false-alarm rate between 0 and 1, found {alpha:g}")
    tune_process()
    options = FitOptions(
        tuple(labels),
        tuple(images),
        classes,
        run_options.read_options(spacing, camera, calibration, start, until, None, None),
        tuple(one.value for one in Fitted if model is None or one in model),
        alpha,
        None if space == "auto" else space,
        complete,
        only_labelled,
        source,
        licence,
    )

    def notify(words: str) -> None:
        typer.echo(visible(words), err=True)

    typer.echo(visible_lines(fit_labels(options, out, overwrite=overwrite, notify=notify)))
