"""The commands that label drives, and fit and measure models on labels. Heavy imports stand inside."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from wayside.pipeline.cli.help import Application, examples, remark
from wayside.pipeline.cli.options import (
    MovedLog,
    Option,
    Overwrite,
    ReviewFiles,
    chosen_settings,
    flag,
    settings_of,
    takes,
)
from wayside.pipeline.cli.running import RunOptions, process
from wayside.pipeline.files.visible_text import counted, visible, visible_lines
from wayside.schemas.errors import PARTS_LOST, UsageError

app = Application("Your own roads")
_RESULT = "result"
Fitted = StrEnum("Fitted", ["color", "shape", "location", "confidence"])
"""What can be fitted."""
Space = Literal["auto", "rgb", "chromaticity", "log_chromaticity", "log_rgb", "lab"]
"""Spaces of the colour classes."""


@app.command(
    epilog=examples(
        "wayside label out -o page",
        "wayside label drive.mcap --spacing 26.4ft -o page",
        "wayside label drive.marks.json -o labels.parquet",
        "wayside label out --review review.json -o labels.parquet",
        "wayside label coco.json --classes classes.toml -o labels.parquet",
    )
)
def label(  # noqa: PLR0913 - one for each option
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="OUT|LOG|LABELS...",
            help="To mark: a folder written by `wayside run`, or a log. To convert: marks.json, COCO, VOC, YOLO or "
            "truth, or a folder of `wayside run` with its review.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", help="Folder for the page, or the .parquet file of labels to write."
        ),
    ],
    most: Annotated[
        int, typer.Option("--boxes", min=0, help="Single boxes to show in addition to landmarks.")
    ] = 300,
    log: MovedLog = None,
    classes: Annotated[
        Path | None,
        typer.Option(help="TOML file: which COCO, VOC or YOLO classes are which signs."),
    ] = None,
    review: ReviewFiles = None,
    spacing: Annotated[
        str | None, typer.Option(help="For a log: distance between images, as for `run`.")
    ] = None,
    preset: Annotated[str, typer.Option(help="For a log: preset of its run.")] = "default",
    overwrite: Overwrite = False,
) -> None:
    """Write a page of candidates to mark by keyboard, the most useful first, or turn marks into labels."""
    if out.suffix.lower() == ".parquet":
        _convert(sources, out, classes, review or (), overwrite=overwrite)
        return
    if len(sources) != 1:
        raise UsageError(
            f"{len(sources)} results or logs are given, but a page shows one. Make a page for each, or write "
            "labels with -o labels.parquet."
        )
    result, lost = sources[0], 0
    if result.suffix.lower() == ".json":
        raise UsageError(
            f"{result}: labels cannot be written to {out}. Give a file name, as in -o labels.parquet."
        )
    if result.is_file():
        from wayside.pipeline.files.settings_file import load_settings

        settings = load_settings(preset, None, [], settings_of({"spacing": spacing}))[0]
        lost = process(result, out / _RESULT, settings, how=RunOptions(overwrite=overwrite))
        result = out / _RESULT
    if _write(result, out, most, log, overwrite=overwrite) or lost:
        raise typer.Exit(PARTS_LOST)


def _convert(
    sources: list[Path],
    out: Path,
    classes: Path | None,
    review: Sequence[Path],
    *,
    overwrite: bool,
) -> None:
    from wayside.pipeline.labels.read import joined, read_labels
    from wayside.pipeline.labels.wayside_labels import write_labels

    labels = joined([read_labels(source, classes, review) for source in sources])
    write_labels(labels, out, overwrite=overwrite)
    kinds = [one.kind for one in labels.labels]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    complete = counted(len(labels.complete), "complete image")
    typer.echo(visible(f"{out}: {counted(len(kinds), 'label')} ({counts}), {complete}"))
    if labels.left_out:
        remark(f"wayside: left out: {labels.reasons}; see docs/labels.md")
        if set(labels.left_out) - {"other_class"}:  # which the class map asks for
            raise typer.Exit(PARTS_LOST)


def _write(result: Path, folder: Path, most: int, log: Path | None, *, overwrite: bool) -> int:
    """Write the page; how many things have no image."""
    from wayside.pipeline.cli.progress import SheetProgress
    from wayside.pipeline.labelling.page import write_page
    from wayside.pipeline.running.tuning import tune_process

    tune_process()
    with SheetProgress("label", "crops") as progress:
        written = write_page(
            result, folder, most=most, log=log, watch=progress.watch, overwrite=overwrite
        )
    asked, more = written.questions, ""
    if asked.left_out:
        more = f", {counted(asked.left_out, 'box', 'boxes')} farther from the threshold left out"
    typer.echo(visible(f"{len(asked.items)} to mark{more}; open {written.path}"))
    if written.lost:
        words = "no image: the log no longer has it, or it cannot be decoded"
        remark(f"wayside: {counted(written.lost, 'has', 'have')} {words}")
    return written.lost


HOW_TO_FIT = {
    "model": Option(list[Fitted], "Fit only this model. Repeat for several.", names=("--model",)),
    "alpha": Option(
        float, "False-alarm rate of each gate, such as 0.01.  [default: as in the shipped models]"
    ),
    "space": Option(Space, "Colour space; auto chooses it by cross-validation.", default="auto"),
    "complete": flag("--complete", "All signs in the labelled images are labelled."),
    "only_labelled": flag(
        "--only-labelled",
        "Leave out classes with too few labelled signs instead of keeping the shipped ones.",
    ),
    "classes": Option(Path, "TOML file: which classes of COCO, YOLO and VOC are which signs."),
    "source": Option(str, "Who made the images and labels; stored in the models.", default=""),
    "licence": Option(str, "Licence of the images; stored in the models.", default=""),
}


@app.command(
    epilog=examples(
        "wayside fit labels.parquet --images drive.mcap -o my_models",
        "wayside fit coco.json --classes classes.toml --images pictures/ --complete -o my_models",
        "wayside fit labels.parquet --images a.mcap --images b.mcap --alpha 0.01 -o my_models",
        "wayside run drive.mcap --models my_models -o out",
    )
)
@takes("spacing", "camera", "calibration", "start", "until", heading="For a log", own=HOW_TO_FIT)
def fit(
    labels: Annotated[
        list[Path],
        typer.Argument(
            metavar="LABELS...",
            help="Labels: wayside's Parquet, COCO, YOLO, VOC, the truth of a drive, or a reviewed result. Give "
            "one, or one for each --images.",
        ),
    ],
    images: Annotated[
        list[Path],
        typer.Option("--images", metavar="LOG|DIR", help="The labelled images. May be repeated."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the models.")],
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Fit colours, shapes, location and confidence to your own labels.

    Writes model files for `wayside run --models`, with counts, thresholds and held-out results. Labels of 50
    images are enough for colours with five signs each.
    """
    from wayside.pipeline.fitting.command import FitOptions, fit_labels
    from wayside.pipeline.running.tuning import tune_process

    own = {name: given.pop(name) for name in HOW_TO_FIT}
    wanted, alpha = own.pop("model") or Fitted, own["alpha"]
    if alpha is not None and not 0 < alpha < 1:
        raise UsageError(f"--alpha: a false-alarm rate must be between 0 and 1, but is {alpha:g}")
    tune_process()
    asked = tuple(one.value for one in Fitted if one in wanted)
    options = FitOptions(tuple(labels), tuple(images), settings_of(given), asked, **own)
    typer.echo(visible_lines(fit_labels(options, out, overwrite=overwrite, notify=remark)))


@app.command(
    epilog=examples(
        "wayside roc drive.mcap --truth drive.truth.json -o roc",
        "wayside roc a.mcap b.mcap --labels labels.parquet --preset report -o roc",
    )
)
@takes("preset", "settings", "assignments", "spacing")
def roc(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="MCAP files.")],
    labels: Annotated[
        list[Path],
        typer.Option(
            "--labels",
            "--truth",
            help="Labels of the images, in any format of docs/labels.md. Repeat for several.",
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Output folder.")],
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Measure every classifier on labelled drives: true and false positives over thresholds, knee, area, confusion.

    Only candidates that reach a classifier in a run count. Bands are 95 %, by resampling whole drives; with
    one drive, its stretches.
    """
    from wayside.pipeline.models.model_files import load_models
    from wayside.pipeline.roc.command import format_curves, measure_roc
    from wayside.pipeline.running.tuning import tune_process

    tune_process()
    chosen = chosen_settings(given)
    models = load_models(chosen)
    curves = measure_roc(logs, labels, out, chosen, models, remark, overwrite=overwrite)
    typer.echo(visible_lines(format_curves(curves)))
