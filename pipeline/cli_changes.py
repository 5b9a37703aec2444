"""The command `wayside changes`. Heavy imports stand inside."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline import cli_options
from wayside.pipeline.cli_help import examples
from wayside.pipeline.visible_text import visible, visible_lines
from wayside.schemas.errors import PARTS_LOST, UsageError

CHANGES_EPILOG = examples(
    "wayside changes inventory --before 2024 --after 2025 -o changes.html",
    "wayside changes inventory --before 2024-03..2024-06 --after 2025-05-17 -o changes.html --all",
)


def changes(
    inventory: Annotated[
        Path, typer.Argument(metavar="INVENTORY", help="Folder of merged drives.")
    ],
    before: Annotated[
        str, typer.Option(help="Earlier survey: 2024, 2024-05, 2024-05-17, 2024-03..2024-06.")
    ],
    after: Annotated[str, typer.Option(help="Later survey, in the same words.")],
    page: Annotated[Path, typer.Option("-o", "--out", help="The page to write.")],
    every: Annotated[
        bool, typer.Option("--all", help="Show unchanged panels, and those not looked at, as well.")
    ] = False,
    settings: cli_options.SettingsFile = None,
    assignments: cli_options.Assignments = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files that stand there.")
    ] = False,
) -> None:
    """Compare two surveys: which signs are unchanged, moved, of another face, new, gone, or were not looked at."""
    from wayside.pipeline.fleet.changes import find_changes
    from wayside.pipeline.fleet.changes_page import write_page
    from wayside.pipeline.fleet.surveys import parse_survey
    from wayside.pipeline.settings_file import load_settings

    chosen, origins = load_settings(file=settings, assignments=assignments or [])
    if alien := [n for n, o in origins.items() if o == "--set" and not n.startswith("changes.")]:
        raise UsageError(
            f"--set {alien[0]}: wanted a setting of the group changes, found one of runs or merging, which are done: "
            "give it to `wayside fleet`"
        )
    surveys = parse_survey(before), parse_survey(after)
    report = find_changes(inventory, *surveys, chosen.changes, overwrite=overwrite)
    typer.echo(visible_lines(str(report)))
    written = write_page(inventory, page, (before, after), every=every, overwrite=overwrite)
    typer.echo(visible(f"{page}: {written.shown} changes"))
    if written.lost_images:
        for fault in written.faults:
            typer.echo(visible(f"wayside: {fault}"), err=True)
        typer.echo(
            f"wayside: {written.lost_images} images are not on the page: no log gives them",
            err=True,
        )
        raise typer.Exit(PARTS_LOST)
