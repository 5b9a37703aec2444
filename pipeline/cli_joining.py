"""The command that makes one log of several parts or of ROS bags. Heavy imports stand inside."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline.cli_running import exit_with
from wayside.pipeline.cli_viewing import Overwrite
from wayside.pipeline.visible_text import visible
from wayside.schemas.errors import PARTS_LOST

JOIN_EPILOG = (
    "Examples: `wayside join bag/ -o drive.mcap` · `wayside join day_0.mcap day_1.mcap -o day.mcap` · "
    "`wayside join old.bag -o drive.mcap`"
)


def join(
    parts: Annotated[
        list[Path],
        typer.Argument(
            metavar="PART...", help="MCAP files in order, ROS 2 bag directories, ROS 1 bags."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The log to write.")],
    overwrite: Overwrite = False,
) -> None:
    """Make one log of the parts of a drive, or of a ROS bag."""
    from wayside.pipeline.joining import join_logs

    joined = join_logs(parts, out, overwrite=overwrite)
    for words in joined.lost:
        typer.echo(visible(f"lost: {words}"), err=True)
    typer.echo(
        visible(
            f"{out}: {joined.messages} messages on {joined.topics} topics of {len(joined.parts)} parts; "
            f"next: wayside info {out}"
        )
    )
    exit_with([PARTS_LOST] if joined.lost else [])
