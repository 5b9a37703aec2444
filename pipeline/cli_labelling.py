"""The command `wayside label`. Heavy imports stand inside."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline.cli_help import examples
from wayside.pipeline.visible_text import visible
from wayside.schemas.errors import PARTS_LOST, UsageError

LABEL_EPILOG = examples(
    "wayside label out -o page",
    "wayside label drive.mcap --spacing 26.4ft -o page",
    "wayside label drive.marks.json -o labels.parquet",
    "wayside label out --review review.json -o labels.parquet",
    "wayside label coco.json --classes classes.toml -o labels.parquet",
)
_RESULT = "result"


def label(
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
            "-o", "--out", help="Folder of the page to mark; or the labels to write, .parquet."
        ),
    ],
    most: Annotated[
        int, typer.Option("--boxes", min=0, help="Single boxes to ask about, beside all landmarks.")
    ] = 300,
    log: Annotated[
        Path | None, typer.Option(help="Where the log lies now, if it has moved since the run.")
    ] = None,
    classes: Annotated[
        Path | None,
        typer.Option(help="TOML: which classes of COCO, VOC and YOLO are signs, and their looks."),
    ] = None,
    review: Annotated[
        Path | None,
        typer.Option(help="OUT to labels: its corrections; default: review.json or .csv in OUT."),
    ] = None,
    spacing: Annotated[
        str | None, typer.Option(help="Log: distance between images, as of `run`.")
    ] = None,
    preset: Annotated[str, typer.Option(help="Log: preset of its run.")] = "default",
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="Replace what stands there under the names of the output."
        ),
    ] = False,
) -> None:
    """Write a page of candidates to mark by keyboard, those first that teach the most; turn marks into labels."""
    if out.suffix.lower() == ".parquet":
        _convert(sources, out, classes, review, overwrite=overwrite)
        return
    if len(sources) != 1:
        raise UsageError(
            f"wanted one result or log to mark, found {len(sources)}; make a page of each, "
            "or write labels with -o labels.parquet"
        )
    result, lost = sources[0], 0
    if result.suffix.lower() == ".json":
        raise UsageError(
            f"{result}: labels become a file of labels, found -o {out}; write -o labels.parquet"
        )
    if result.is_file():
        lost = _run(result, out / _RESULT, spacing, preset, overwrite=overwrite)
        result = out / _RESULT
    if _write(result, out, most, log, overwrite=overwrite) or lost:
        raise typer.Exit(PARTS_LOST)


def _convert(
    sources: list[Path], out: Path, classes: Path | None, review: Path | None, *, overwrite: bool
) -> None:
    from wayside.pipeline.label_file import write_labels
    from wayside.pipeline.labels import joined, read_labels
    from wayside.pipeline.result import RUN_FILE
    from wayside.pipeline.reviewing.labels import review_labels
    from wayside.pipeline.reviewing.review import required_review

    labels = joined(
        [
            review_labels(source, required_review(source, review))
            if (source / RUN_FILE).is_file()
            else read_labels(source, classes)
            for source in sources
        ]
    )
    write_labels(labels, out, overwrite=overwrite)
    kinds = [one.kind for one in labels.labels]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    typer.echo(
        visible(f"{out}: {len(kinds)} labels ({counts}), {len(labels.complete)} complete images")
    )
    if labels.left_out:
        typer.echo(visible(f"wayside: left out: {labels.reasons}; see docs/labels.md"), err=True)
        if set(labels.left_out) - {"other_class"}:  # which the class map asks for
            raise typer.Exit(PARTS_LOST)


def _run(log: Path, folder: Path, spacing: str | None, preset: str, *, overwrite: bool) -> int:
    """Run a log first; the exit status that this asks for."""
    from wayside.pipeline.cli_running import process
    from wayside.pipeline.lengths import parse_spacing
    from wayside.pipeline.settings_file import load_settings

    options = {} if spacing is None else {"read.spacing_m": parse_spacing(spacing)}
    settings = load_settings(preset, None, [], options)[0]
    return process(log, folder, settings, None, overwrite=overwrite)


def _write(result: Path, folder: Path, most: int, log: Path | None, *, overwrite: bool) -> int:
    """Write the page; how many things have no image."""
    from wayside.pipeline.labelling.page import write_page
    from wayside.pipeline.progress import SheetProgress
    from wayside.pipeline.tuning import tune_process

    tune_process()
    with SheetProgress("label", "crops") as progress:
        written = write_page(
            result, folder, most=most, log=log, watch=progress.watch, overwrite=overwrite
        )
    asked = written.questions
    more = (
        f", {asked.left_out} single boxes farther from the threshold left out"
        if asked.left_out
        else ""
    )
    typer.echo(visible(f"{len(asked.items)} to mark{more}; open {written.path}"))
    if written.lost:
        typer.echo(
            f"wayside: {written.lost} have no image: the log no longer holds it, or it does not decode",
            err=True,
        )
    return written.lost
