"""Commands that show what a result rests on. Heavy imports stand inside, so that --help answers at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wayside.schemas.errors import PARTS_LOST


def evidence(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder written by `wayside run`.")],
    sign: Annotated[
        str | None, typer.Option(metavar="ID", help="Only this sign, without an index.")
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="Where the log lies now, if it has moved since the run.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("-o", "--out", help="Where the sheets go; default: OUT/evidence.")
    ] = None,
) -> None:
    """Write a sheet of pictures, maps and figures for every sign, and an index to filter them."""
    import cv2

    from wayside.pipeline.evidence.write import write_evidence
    from wayside.pipeline.progress import SheetProgress

    cv2.setNumThreads(1)
    with SheetProgress("evidence") as progress:
        written = write_evidence(
            out,
            out / "evidence" if folder is None else folder,
            sign_id=sign,
            log=log,
            watch=progress.watch,
        )
    count = len(written.sheets)
    if written.index is not None:
        typer.echo(f"{count} {'sheet' if count == 1 else 'sheets'}; open {written.index}")
    else:
        typer.echo(str(written.sheets[0]))
    if written.lost_views:
        typer.echo(
            f"wayside: {written.lost_views} views have no picture: the log no longer holds it, or it does not decode; "
            "their places on the sheets are empty",
            err=True,
        )
        raise typer.Exit(PARTS_LOST)
