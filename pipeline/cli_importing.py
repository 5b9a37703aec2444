"""The commands that make a log: of images, of parts or of ROS bags. Heavy imports stand inside."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from wayside.pipeline.cli_help import examples
from wayside.pipeline.cli_running import exit_with
from wayside.pipeline.cli_viewing import Overwrite
from wayside.pipeline.visible_text import visible
from wayside.schemas.errors import PARTS_LOST


class Order(StrEnum):
    """What decides the order of images, whatever contradicts it."""

    by_name = "name"
    by_date = "date"


IMPORT_EPILOG = examples(
    "wayside import images/*.jpg --calibration camera.yaml --spacing 26.4ft -o drive.mcap"
)
JOIN_EPILOG = examples(
    "wayside join bag/ -o drive.mcap",
    "wayside join day_0.mcap day_1.mcap -o day.mcap",
    "wayside join old.bag -o drive.mcap",
)


def import_(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGES...", help="Numbered images, or a folder.")
    ],
    calibration: Annotated[
        Path, typer.Option(help="Camera calibration: YAML of ROS, OpenCV or Kalibr.")
    ],
    spacing: Annotated[str, typer.Option(help="Distance between images: 26.4ft, 8m.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The log to write.")],
    order: Annotated[
        Order | None,
        typer.Option(help="What decides the order where names and dates of capture disagree."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Make a log of numbered images."""
    from wayside.pipeline.importing import import_images
    from wayside.pipeline.lengths import parse_spacing
    from wayside.pipeline.progress import SheetProgress

    with SheetProgress("import", "images") as progress:
        count, left_out = import_images(
            images,
            calibration,
            parse_spacing(spacing),
            out,
            order=order or "",
            overwrite=overwrite,
            warn=lambda words: typer.echo(visible(f"note: {words}"), err=True),
            watch=progress.watch,
        )
    typer.echo(visible(f"{out}: {count} images; next: wayside run {out} -o out"))
    exit_with([PARTS_LOST] if left_out else [])


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
    count = len(joined.parts)
    typer.echo(
        visible(
            f"{out}: {joined.messages} messages on {joined.topics} topics of {count} part{'s' * (count != 1)}; "
            f"next: wayside info {out}"
        )
    )
    exit_with([PARTS_LOST] if joined.lost else [])
