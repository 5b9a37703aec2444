"""All figures of the report on one drive, written as one page."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.learning.page import Figure
from wayside.pipeline.pages import render_page, write_page
from wayside.pipeline.report_figures import segments, tracks
from wayside.pipeline.report_figures.decisions import neyman_pearson_figures, roc_figures
from wayside.pipeline.report_figures.drive import (
    ALMOST_NO,
    NEARLY_ALL,
    PRESET,
    REPORT,
    Drive,
    figure,
    gather_drive,
    labels_beside,
)

PAGE, MARK = "report_figures.html", "wayside report-figures"


def write_figures(
    log: Path,
    folder: Path,
    *,
    labels: Path | None = None,
    boards: list[Path] | None = None,
    board: str | None = None,
    assignments: list[str] | None = None,
    options: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> tuple[Path, list[Figure]]:
    """Run the report's chain over a log with labels, and write the page; the page and its figures.

    `labels`: in any format that is read; None: those in the log's folder. `boards`, `board`: images of a chessboard and
    its inner corners (9x6), for figure 6.1. `assignments`, `options`: settings GROUP.NAME=VALUE, and by their names.
    `overwrite`: replace a file of the user's; wayside's own page is always replaced. Raises InputError, UsageError,
    StageError as in `gather_drive` and `calibrate_images`, OutputError where the page cannot be written.
    """
    page = folder / PAGE
    labelled = labels_beside(log) if labels is None else labels
    drive = gather_drive(log, labelled, assignments or [], options)
    chapters = chapters_of(drive, boards or [], board)
    figures = [one for _, own in chapters for one in own]
    words = (
        f"Preset {PRESET} on {len(drive.frames)} images with {int(drive.faces.example.sum())} labelled views of signs, "
        "each figure and number beside that of the report; shares have their 95 % interval. TPR and FPR are eq. 10.1 "
        "and 10.2 on the segments that pass the size gate: how many of those on signs of a colour, and of those on no "
        "sign, lie within the threshold of that colour.",
        "A claim is met where this drive reaches the number of the report, and open where only its interval does. "
        f'"Near perfect", "typically all" and a low residual are read as {100 * NEARLY_ALL:g} %, "almost no" as '
        f"{100 * ALMOST_NO:g} false places in 100 images; pass two must find half of what pass one loses.",
    )
    title = f"Figures of KS-09-9 on {visible(log.stem)}"
    content = render_page("figures.html", MARK, title=title, intro=words, chapters=chapters)
    write_page(page, content, MARK, overwrite=overwrite)
    return page, figures


def chapters_of(
    drive: Drive, boards: list[Path], board: str | None
) -> list[tuple[str, list[Figure]]]:
    """All figures by chapter of the report; a figure that the drive cannot fill says what it needs."""
    draw: tuple[Callable[[Drive], Iterable[Figure]], ...] = (
        segments.segmentation_figures,
        segments.color_figures,
        segments.shape_figures,
        tracks.track_figures,
        lambda _: tracks.board_figure(boards, board),
        tracks.residual_figure,
        tracks.scene_figures,
        neyman_pearson_figures,
        roc_figures,
        tracks.result_figures,
    )
    chapters = []
    for (chapter, numbers), one in zip(REPORT.items(), draw, strict=True):
        made = {own.number: own for own in one(drive)}
        chapters.append((chapter, [made.get(number) or figure(number) for number in numbers]))
    return chapters
