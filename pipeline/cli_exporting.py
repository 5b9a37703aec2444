"""The command `wayside export`. Heavy imports stand inside."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline.cli_help import examples
from wayside.pipeline.visible_text import visible
from wayside.schemas.errors import UsageError

EXPORT_EPILOG = examples(
    "wayside export out -o signs.csv",
    "wayside export out -f gpkg --units us --crs EPSG:26914",
    "wayside export out -o signs.geojson --review review.csv",
    "wayside export out -f mcap -o drive.signs.mcap",
    "wayside export inventory -f gpkg --table supports",
)


class Format(StrEnum):
    """What the file is."""

    csv = "csv"
    geojson = "geojson"
    gpkg = "gpkg"
    shp = "shp"
    kml = "kml"
    mcap = "mcap"


class Units(StrEnum):
    """Of lengths."""

    metric = "metric"
    us = "us"


class InventoryTable(StrEnum):
    """Of an inventory."""

    panels = "panels"
    supports = "supports"


Review = Annotated[
    Path | None,
    typer.Option(
        help="Corrections saved by the evidence index; default: review.json or .csv in OUT."
    ),
]


def export(
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="Folder written by `wayside run`, or an inventory of `wayside fleet`.",
        ),
    ],
    file: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            help="The file to write.  [default: signs.FORMAT in OUT; of an inventory TABLE.FORMAT]",
        ),
    ] = None,
    kind: Annotated[
        Format | None, typer.Option("-f", "--format", help="Default: by the end of the name.")
    ] = None,
    table: Annotated[
        InventoryTable | None,
        typer.Option(help="Of an inventory: what has a row each.  [default: panels]"),
    ] = None,
    units: Annotated[
        Units, typer.Option(help="`us`: distances in feet, sizes of signs in inches.")
    ] = Units.metric,
    crs: Annotated[
        str | None,
        typer.Option(
            metavar="EPSG:...",
            help="csv, gpkg, shp: coordinate reference system.  [default: WGS 84]",
        ),
    ] = None,
    review: Review = None,
    log: Annotated[
        Path | None,
        typer.Option(help="mcap: where the log lies now, if it has moved since the run."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a file that stands there.")
    ] = False,
) -> None:
    """Write the signs for other programs, with corrections beside what was measured."""
    from wayside.pipeline.exporting.export import export as write
    from wayside.pipeline.exporting.sources import is_inventory
    from wayside.pipeline.reviewing.review import NO_REVIEW, find_review

    chosen = _format_of(file, kind)
    inventory = is_inventory(out)
    name = (table or InventoryTable.panels).value if inventory else "signs"
    target = out / f"{name}.{chosen}" if file is None else file
    if inventory and review is not None:
        raise UsageError(
            f"--review {review}: wanted the result of one drive, found the inventory {out}; leave --review out"
        )
    said = NO_REVIEW if inventory else find_review(out, review)
    done = write(
        out,
        said,
        target,
        chosen,
        table=None if table is None else table.value,
        units=units.value,
        crs=crs,
        log=log,
        overwrite=overwrite,
    )
    reviewed = len(said.rows) + len(said.missing)
    more = f", {reviewed} of them reviewed" if reviewed else ""
    parts = "".join(f", {part.name}" for part in done.files if part != target)
    for note in done.notes:
        typer.echo(visible(f"note: {note}"), err=True)
    typer.echo(visible(f"{target}{parts}: {done.rows} rows{more}"))


def _format_of(file: Path | None, kind: Format | None) -> str:
    """The format that is asked for, else that of the file's name."""
    known = ", ".join(f".{one.value}" for one in Format)
    ending = "" if file is None else file.suffix.lower().removeprefix(".")
    if kind is not None:
        if kind is Format.shp and file is not None and ending != kind:
            raise UsageError(f"{file}: wanted a name that ends with .shp, as its parts share it")
        return kind.value
    if ending not in [one.value for one in Format]:
        raise UsageError(
            f"{file or 'wayside export'}: wanted -f, or -o with a name that ends with one of {known}"
        )
    return ending


def evaluate_review(out: Path, review: Path, json: Path | None, *, overwrite: bool) -> None:
    """Print what a review says of a result, and write its figures where that is asked for."""
    from wayside.pipeline.reviewing.figures import format_figures, review_figures
    from wayside.pipeline.reviewing.review import read_review
    from wayside.pipeline.writing import write_json

    figures = review_figures(out, read_review(review, out))
    if json is not None:
        write_json(json, figures.to_json(), ("reviewed", "accepted"), overwrite=overwrite)
    typer.echo(format_figures(figures))
