"""The commands of many drives: `wayside fleet`, `query` and `changes`. Heavy imports stand inside."""

import csv
import sys
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayside.pipeline.cli.help import Application, CommandGroup, examples, remark
from wayside.pipeline.cli.options import Option, Overwrite, chosen_settings, flag, takes
from wayside.pipeline.cli.running import SELF_CALIBRATE, exit_with
from wayside.pipeline.files.visible_text import counted, visible, visible_lines
from wayside.schemas.errors import PARTS_LOST, UsageError

if TYPE_CHECKING:
    from wayside.pipeline.fleet.manifest import Entry
    from wayside.pipeline.fleet.running import FleetReport
    from wayside.schemas.settings import Settings

HEADING = "Many drives"
app = Application(HEADING)
_MOST_LISTED = 40
_LOGS_FIRST = "run"
OF_A_LOG = ("spacing", "camera", "calibration", "route", "milepost", "decreasing")
"""Options that a row of a table of logs may have."""
FLEET_EPILOG = examples(
    "wayside fleet archive/2026/ -o inventory --jobs 4",
    'wayside fleet "s3://survey/2026/**/*.mcap" -o inventory --scheduler tcp://10.0.0.5:8786',
    "wayside fleet logs.csv -o inventory",
    "wayside fleet status inventory",
)


class LogsFirst(CommandGroup):
    """Commands of `wayside fleet`. Logs in the place of a command run the command `run`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put `run` before arguments that begin with no command; the type of `ctx` is private to typer."""
        if args and args[0] not in (*self.commands, *ctx.help_option_names):
            args = [_LOGS_FIRST, *args]
        return super().parse_args(ctx, args)


fleet_app = Application(
    cls=LogsFirst,
    no_args_is_help=True,
    help="Process many logs into one inventory: `wayside fleet LOGS... -o INVENTORY`. See `wayside fleet run --help`.",
    epilog=FLEET_EPILOG,
)

Inventory = Annotated[
    Path, typer.Argument(metavar="INVENTORY", help="Folder written by `wayside fleet`.")
]


AnswerFormat = StrEnum("AnswerFormat", ["table", "csv", "json", "parquet"])
"""What an answer is written as."""
HOW_TO_RUN = {
    "jobs": Option(
        int,
        "Number of logs processed in parallel.  [default: 1; with a scheduler: its threads]",
        names=("-j", "--jobs"),
        least=1,
    ),
    "scheduler": Option(
        str,
        "Run on Dask distributed: on a cluster, or on local workers.",
        metavar="tcp://HOST:PORT|local",
    ),
    "attempts": Option(
        int, "Number of attempts before a log goes into quarantine.", default=3, least=1
    ),
    "self_calibrate": SELF_CALIBRATE,
    "retry": flag("--retry", "Try the logs in quarantine again."),
    "overwrite": flag("--overwrite", "Replace results of logs whose content has changed."),
}


@fleet_app.command(_LOGS_FIRST, epilog=FLEET_EPILOG)
@takes(
    *("spacing", "camera", "calibration", "every", "workers", "preset", "settings", "assignments"),
    *("detector", "classes", "models", "route", "routes"),
    own=HOW_TO_RUN,
)
def fleet(
    logs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOGS...",
            help="MCAP files, folders, patterns, object storage URLs, @list.txt with one log per line, or a CSV "
            "table with the column log and optional columns route, milepost, camera, calibration.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="INVENTORY", help="Inventory folder. You can add logs later."
        ),
    ],
    **given: Any,
) -> None:
    """Process many logs into one inventory, each log once, and merge their signs.

    A log is skipped if it has a result from the same log, settings and models. So the same command continues
    where it stopped. A log that crashes its worker is tried again, and goes into quarantine after three attempts.
    """
    from wayside.pipeline.cli.progress import FleetProgress
    from wayside.pipeline.fleet.running import run_fleet
    from wayside.pipeline.fleet.sources import expand_sources
    from wayside.pipeline.fleet.task import FleetOptions

    for name, value in given.items():
        if isinstance(value, Path):  # workers may have other working folders
            given[name] = value.absolute()
    chosen = chosen_settings(given)
    own: dict[str, Settings] = {}
    for table in (one for one in logs if one.lower().endswith(".csv")):
        own |= read_log_table(Path(table), given)
    uris = [*own, *expand_sources(one for one in logs if not one.lower().endswith(".csv"))]
    how = FleetOptions(**{name: given[name] for name in HOW_TO_RUN}, arguments=tuple(sys.argv[1:]))
    with FleetProgress() as progress:
        report = run_fleet(uris, out, chosen, how, progress.watch, progress.watch_merging, own=own)
    typer.echo(visible_lines(_summary(report, out)))
    exit_with([entry.status for entry in report.entries])


def read_log_table(file: Path, given: Mapping[str, Any]) -> "dict[str, Settings]":
    """The logs of a CSV file, each with its settings: the options `given`, and those of its row instead.

    Raises UsageError for a file that cannot be read, without the column `log`, or with other columns than options.
    """
    from wayside.pipeline.files.parsing import read_csv
    from wayside.pipeline.fleet.sources import expand_sources

    try:
        names, rows = read_csv(file)
    except (OSError, ValueError, csv.Error) as error:
        raise UsageError(f"{file}: the table of logs cannot be read: {error}") from error
    if "log" not in names or (alien := [n for n in names if n not in ("log", *OF_A_LOG)]):
        wrong = "has no column log" if "log" not in names else f"has a column {alien[0]}"
        raise UsageError(f"{file} {wrong}. Its columns are log, {', '.join(OF_A_LOG)}.")
    found: dict[str, Settings] = {}
    for row in rows:
        told: dict[str, Any] = {name: text for name, text in row.items() if name != "log"}
        for name in told.keys() & {"decreasing"}:
            told[name] = told[name].lower() in ("yes", "true", "1")
        for name in told.keys() & {"calibration"}:
            told[name] = Path(told[name]).absolute()
        found |= dict.fromkeys(expand_sources([row["log"]]), chosen_settings({**given, **told}))
    return found


@fleet_app.command(epilog=examples("wayside fleet status inventory"))
def status(inventory: Inventory) -> None:
    """Show the progress of a fleet: logs done, running and in quarantine, rate and time left."""
    from wayside.pipeline.fleet.status import format_status

    typer.echo(visible_lines(format_status(inventory)))


@app.command(
    epilog=examples(
        'wayside query inventory "SELECT color, count(*) FROM panels GROUP BY color"',
        'wayside query inventory "FROM signs WHERE confidence < 0.6" -o weak.csv',
        'wayside query inventory "DESCRIBE panels"',
    )
)
def query(
    inventory: Inventory,
    sql: Annotated[str, typer.Argument(metavar="SQL", help="One query in DuckDB SQL.")],
    file: Annotated[Path | None, typer.Option("-o", "--out", help="Write the result here.")] = None,
    kind: Annotated[
        AnswerFormat | None,
        typer.Option(
            "-f", "--format", help="Default: by the file extension; a table on the terminal."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Query an inventory with SQL. Views: panels, supports, sightings, signs, frames, observations, checks, logs."""
    from wayside.pipeline.files.writing import whole_file
    from wayside.pipeline.fleet.query import FORMATS, first_rows, write_answer

    suffix = "table" if file is None else file.suffix.lower().removeprefix(".")
    chosen = suffix if kind is None else kind.value
    if chosen in FORMATS:
        if file is None:
            write_answer(inventory, sql, sys.stdout.buffer, chosen)
        else:
            with whole_file(file, overwrite=overwrite) as stream:
                write_answer(inventory, sql, stream, chosen)
            typer.echo(visible(f"{file}: written"))
        return
    if file is not None:
        raise UsageError(
            f"{file}: the format is unknown. Give a name that ends with {', '.join(f'.{f}' for f in FORMATS)}, or -f "
            "with one of these."
        )
    names, rows = first_rows(inventory, sql, _MOST_LISTED + 1)
    _print_table(names, rows)


def _print_table(names: list[str], rows: list[list[str | None]]) -> None:
    from rich.console import Console
    from rich.table import Table

    from wayside.pipeline.cli.summary import plain

    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in names:
        table.add_column(plain(name), overflow="fold")
    for row in rows[:_MOST_LISTED]:
        table.add_row(*("" if value is None else plain(value) for value in row))
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 400)
    console.print(table)
    if len(rows) > _MOST_LISTED:
        console.print(f"... and more; -f csv writes all rows, or add LIMIT {_MOST_LISTED}")


def _summary(report: "FleetReport", out: Path) -> str:
    """What became of the logs: each of a few, of many those that are not simply done."""
    from wayside.pipeline.fleet.manifest import DRIVES, QUARANTINE, State

    def describe(entry: "Entry") -> str:
        if entry.state != State.DONE:
            where = f"; see {out / QUARANTINE / entry.name}" if entry.attempts else ""
            return f"failed, exit status {entry.status}: {entry.words}{where}"
        words = "unchanged, result" if entry.name in report.kept else "done, result"
        more = f", exit status {entry.status}" if entry.status else ""
        return f"{words} in {out / DRIVES / entry.name}{more}"

    listed = [
        entry for entry in report.entries if len(report.entries) <= _MOST_LISTED or entry.status
    ]
    lines = [f"{entry.source}: {describe(entry)}" for entry in listed[:_MOST_LISTED]]
    if len(listed) > _MOST_LISTED:
        lines.append(f"... and {len(listed) - _MOST_LISTED} more: wayside fleet status {out}")
    lines += [f"{uri}: the same recording as {name}, counted once" for uri, name in report.copies]
    if report.left:
        some = ", ".join(report.left[:_MOST_LISTED])
        lines.append(f"{counted(len(report.left), 'log')} removed, as results are gone: {some}")
    done = sum(entry.state == State.DONE for entry in report.entries)
    lines.append(
        f"{done} of {counted(len(report.entries), 'log')} done, {len(report.kept)} of them in an earlier run"
    )
    lines.append("panels unchanged" if report.merged is None else f"merged: {report.merged}")
    return "\n".join(lines)


@app.command(
    epilog=examples(
        "wayside changes inventory --before 2024 --after 2025 -o changes.html",
        "wayside changes inventory --before 2024-03..2024-06 --after 2025-05-17 -o changes.html --all",
    )
)
@takes("settings", "assignments", "units")
def changes(
    inventory: Annotated[
        Path, typer.Argument(metavar="INVENTORY", help="Inventory written by `wayside fleet`.")
    ],
    before: Annotated[
        str, typer.Option(help="Earlier survey: 2024, 2024-05, 2024-05-17, 2024-03..2024-06.")
    ],
    after: Annotated[str, typer.Option(help="Later survey, in the same format.")],
    page: Annotated[Path, typer.Option("-o", "--out", help="The page to write.")],
    every: Annotated[
        bool, typer.Option("--all", help="Also show panels that are unchanged or were not in view.")
    ] = False,
    review: Annotated[
        list[Path] | None,
        typer.Option(
            help="Reviews saved from the page. Repeat to merge several.  [default: changes.review*.json in INVENTORY]"
        ),
    ] = None,
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Compare two surveys: which signs are unchanged, moved, new, gone, not covered, or have another face."""
    from wayside.pipeline.evidence.marks import UNITS
    from wayside.pipeline.files.settings_file import load_settings
    from wayside.pipeline.fleet.changes import find_changes, parse_survey
    from wayside.pipeline.fleet.changes_page import write_page

    chosen, origins = load_settings(file=given["settings"], assignments=given["assignments"] or [])
    if alien := [n for n, o in origins.items() if o == "--set" and not n.startswith("changes.")]:
        raise UsageError(
            f"--set {alien[0]}: only settings of the group changes apply here. Give settings of runs and "
            "merging to `wayside fleet`."
        )
    surveys = parse_survey(before), parse_survey(after)
    report = find_changes(
        inventory, *surveys, chosen.changes, reviews=review or (), overwrite=overwrite
    )
    typer.echo(visible_lines(str(report)))
    names, units = (before, after), UNITS[given["units"].value]
    written = write_page(inventory, page, names, every=every, units=units, overwrite=overwrite)
    typer.echo(visible(f"{page}: {counted(written.shown, 'change')}"))
    if written.lost_images:
        for fault in written.faults:
            remark(f"wayside: {fault}")
        lost = counted(written.lost_images, "image")
        remark(f"wayside: not on the page, as no log has them: {lost}")
        raise typer.Exit(PARTS_LOST)
