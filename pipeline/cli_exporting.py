"""The command `wayside export`. Heavy imports stand inside."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline.visible_text import visible
from wayside.schemas.errors import UsageError

EXPORT_EPILOG = (
    "Examples: `wayside export out -o signs.csv` · "
    "`wayside export out -o signs.geojson --review review.csv`"
)


class Format(StrEnum):
    """What the file is."""

    csv = "csv"
    geojson = "geojson"


Review = Annotated[
    Path | None,
    typer.Option(
        help="Corrections saved by the evidence index; default: review.json or .csv in OUT."
    ),
]


def export(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder written by `wayside run`.")],
    file: Annotated[Path, typer.Option("-o", "--out", help="The file to write.")],
    kind: Annotated[
        Format | None, typer.Option("-f", "--format", help="Default: by the end of the name.")
    ] = None,
    review: Review = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a file that stands there.")
    ] = False,
) -> None:
    """Write the signs as one flat table, with corrections beside what was measured."""
    from wayside.pipeline.reviewing.export import FORMATS
    from wayside.pipeline.reviewing.export import export as write
    from wayside.pipeline.reviewing.review import find_review

    chosen = file.suffix.lower().removeprefix(".") if kind is None else kind.value
    if chosen not in FORMATS:
        raise UsageError(
            f"{file}: wanted a name that ends with {' or '.join(f'.{f}' for f in FORMATS)}, or -f with one of these"
        )
    said = find_review(out, review)
    rows = write(out, said, file, chosen, overwrite=overwrite)
    reviewed = len(said.rows) + len(said.missing)
    more = f", {reviewed} of them reviewed" if reviewed else ""
    typer.echo(visible(f"{file}: {rows} rows{more}"))


def evaluate_review(out: Path, review: Path, json: Path | None, *, overwrite: bool) -> None:
    """Print what a review says of a result, and write its figures where that is asked for."""
    from wayside.pipeline.reviewing.figures import format_figures, review_figures
    from wayside.pipeline.reviewing.review import read_review
    from wayside.pipeline.writing import write_json

    figures = review_figures(out, read_review(review, out))
    if json is not None:
        write_json(json, figures.to_json(), ("reviewed", "accepted"), overwrite=overwrite)
    typer.echo(format_figures(figures))
