"""One run for the commands that make runs: its progress, its summary, its exit status. Heavy imports stand inside."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wayside.pipeline.process import in_words, report_error
from wayside.schemas.errors import (
    PARTS_LOST,
    InputError,
    InterruptionError,
    OutputError,
    StageError,
    UsageError,
    WaysideError,
)

if TYPE_CHECKING:
    from wayside.pipeline.view.sinks import Viewing
    from wayside.schemas.settings import Settings


def process_all(
    logs: list[Path],
    folders: list[Path],
    settings: Settings,
    viewing: Viewing | None,
    *,
    every_region: bool = False,
    overwrite: bool = False,
    resume: bool = False,
    verbose: bool = False,
) -> None:
    """Run logs one after the other and end with the gravest status.

    Of several, all places of results are looked at before the first is run. One that cannot be run is told and the
    others are done; one whose result stands already, made of the same log with the same settings and models, is passed
    over (not with `overwrite`, nor where a viewer is to see it).

    Raises
    ------
    UsageError
        Two logs would be written to one folder.
    OutputError
        Something stands in the place of a result.
    InterruptionError
        Somebody ended the work: of all logs.
    """
    from wayside.pipeline.earlier_result import check_earlier, is_finished
    from wayside.pipeline.journal import result_key
    from wayside.pipeline.model_files import load_models
    from wayside.pipeline.output_folder import finish_replacement
    from wayside.pipeline.visible_text import visible

    def run_one(log: Path, folder: Path) -> int:
        return process(
            log,
            folder,
            settings,
            viewing,
            every_region=every_region,
            overwrite=overwrite,
            resume=resume,
            verbose=verbose,
        )

    if len(logs) == 1:
        exit_with([run_one(read_as_log(logs[0]), folders[0])])
        return
    if len(set(folders)) < len(folders):
        twice = next(folder for folder in folders if folders.count(folder) > 1)
        raise UsageError(
            f"wanted logs of different names, as each gets a folder of its name, found two for {twice}; "
            "run them one by one"
        )
    for log, folder in zip(logs, folders, strict=True):
        finish_replacement(folder)
        standing = _standing_log(log)
        if standing is not None:
            check_earlier(folder, standing, overwrite=overwrite)
    digests = load_models(settings).digests()
    ends: list[tuple[int, str]] = []
    for number, (log, folder) in enumerate(zip(logs, folders, strict=True), 1):
        typer.echo(visible(f"log {number} of {len(logs)}: {log}"))
        try:
            source = read_as_log(log)
            key = result_key(source, settings, digests, every_region=every_region)
            if viewing is None and not overwrite and is_finished(folder, key):
                ends.append((0, f"unchanged, result in {folder} kept"))
                continue
            status = run_one(source, folder)
        except InterruptionError:
            raise
        except (WaysideError, OSError) as error:
            told = in_words(error) if isinstance(error, OSError) else error
            status = report_error(told, debug="--debug" in sys.argv[1:])
            ends.append((status, f"not done, exit status {status}"))
        else:
            words = f"done, result in {folder}"
            ends.append((status, f"{words}, exit status {status}" if status else words))
    typer.echo("")
    for log, (_, words) in zip(logs, ends, strict=True):
        typer.echo(visible(f"{log}: {words}"))
    exit_with([status for status, _ in ends])


def read_as_log(path: Path) -> Path:
    """What is to be read of a recording; says on stderr where the log of a ROS bag lies. Raises as `readable_log`."""
    from wayside.pipeline.bags import readable_log
    from wayside.pipeline.visible_text import visible

    return readable_log(path, lambda words: typer.echo(visible(words), err=True))


def _standing_log(path: Path) -> Path | None:
    """What `read_as_log` gives where it is there already; None for a bag that is still to be joined, or is none."""
    from wayside.pipeline.bags import joined_log

    try:
        log = joined_log(path)
        return path if log is None else log if log.exists() else None
    except (InputError, OSError):
        return None  # told when it is its turn


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
    verbose: bool = False,
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

    under_way = Run()
    try:
        with (
            FrameProgress(log.name, under_way) as progress,
            watched_compilation(progress.compiling),
        ):
            result = run_log(
                log,
                folder,
                settings,
                models,
                under_way,
                arguments=sys.argv[1:],
                every_region=every_region,
                open_observer=open_observer,
                rate=rate,
                overwrite=overwrite,
                resume=resume,
            )
    except KeyboardInterrupt as error:
        done = "were" if under_way.committed else "were not"
        more = "; the same command goes on from here" if resume and not under_way.committed else ""
        raise InterruptionError(f"interrupted; this log's tables {done} written{more}") from error
    seen = sys.stdout.isatty()  # a pipe gets each statement as one line
    console = Console(highlight=False, soft_wrap=not seen, width=None if seen else 160)
    print_summary(result, console, kept=kept, verbose=verbose)
    if result.recorded is False:
        return OutputError.exit_status
    return PARTS_LOST if result.lost else 0


EXIT_STATUSES = """Exit status:

- 0 done
- 1 a fault of wayside
- 2 wrong arguments or settings
- 3 the input cannot be used
- 4 done, but parts of the input were lost
- 5 the output could not be written, or something stands in its place
- 130 interrupted"""
"""For the help."""
_GRAVEST = (
    StageError.exit_status,
    OutputError.exit_status,
    InputError.exit_status,
    UsageError.exit_status,
    PARTS_LOST,
)


def exit_with(statuses: list[int]) -> None:
    """End with the gravest of the statuses: what is not done at all, then parts that are lost."""
    for status in _GRAVEST:
        if status in statuses:
            raise typer.Exit(status)
