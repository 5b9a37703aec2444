"""One run for the commands that make runs: its progress, its summary, its exit status. Heavy imports stand inside."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wayside.schemas.errors import PARTS_LOST, InterruptionError, OutputError, UsageError

if TYPE_CHECKING:
    from wayside.pipeline.view.sinks import Viewing
    from wayside.schemas.settings import Settings


def check_folders(logs: list[Path], folders: list[Path], *, overwrite: bool) -> None:
    """Make sure, before the first of several logs is run, that the result of each may be written.

    Raises
    ------
    UsageError
        Two logs would be written to one folder.
    OutputError
        Something stands in the place of a result.
    """
    if len(logs) == 1:
        return  # the run itself looks before it begins
    from wayside.pipeline.earlier_result import check_earlier
    from wayside.pipeline.output_folder import finish_replacement

    if len(set(folders)) < len(folders):
        twice = next(folder for folder in folders if folders.count(folder) > 1)
        raise UsageError(
            f"wanted logs of different names, as each gets a folder of its name, found two for {twice}; "
            "run them one by one"
        )
    for log, folder in zip(logs, folders, strict=True):
        finish_replacement(folder)
        check_earlier(folder, log, overwrite=overwrite)


def process(
    log: Path,
    folder: Path,
    settings: Settings,
    viewing: Viewing | None,
    *,
    every_region: bool = False,
    rate: float | None = None,
    kept: bool = True,
    overwrite: bool = False,
    resume: bool = False,
) -> int:
    """Run one log with progress and a closing summary; the exit status that it asks for."""
    from rich.console import Console

    from wayside.pipeline.model_files import load_models
    from wayside.pipeline.progress import FrameProgress
    from wayside.pipeline.reading.frames import ReadReport
    from wayside.pipeline.run import Run, RunObserver, run_log
    from wayside.pipeline.summary import print_summary
    from wayside.pipeline.tuning import tune_process, watched_compilation
    from wayside.pipeline.visible_text import visible

    tune_process()
    models = load_models(settings)

    def open_observer(report: ReadReport, part: Path) -> RunObserver | None:
        if viewing is None:
            return None
        from wayside.pipeline.view.sinks import open_observer

        return open_observer(viewing, part, visible(log.stem), models.location_classes, report)

    size = log.stat().st_size if log.exists() else 0
    under_way = Run()
    try:
        with FrameProgress(log.name, size) as progress, watched_compilation(progress.compiling):
            result = run_log(
                log,
                folder,
                settings,
                models,
                under_way,
                arguments=sys.argv[1:],
                every_region=every_region,
                watch=progress.watch,
                open_observer=open_observer,
                rate=rate,
                overwrite=overwrite,
                resume=resume,
            )
    except KeyboardInterrupt as error:
        done = "were" if under_way.committed else "were not"
        more = "; the same command goes on from here" if resume and not under_way.committed else ""
        raise InterruptionError(f"interrupted; this log's tables {done} written{more}") from error
    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else 120)
    print_summary(result, console, kept=kept)
    if result.recorded is False:
        return OutputError.exit_status
    return PARTS_LOST if result.lost else 0


def exit_with(statuses: list[int]) -> None:
    """End with the gravest of the statuses: an output that is not written, then parts that are lost."""
    if any(statuses):
        raise typer.Exit(max(statuses))
