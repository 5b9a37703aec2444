"""The program `wayside`. Heavy imports stand inside the commands, so that --help answers at once."""

import sys
from importlib.abc import MetaPathFinder
from typing import Annotated

import typer

import wayside
from wayside.pipeline.cli import drive, fleet, learning, planning, result, running
from wayside.pipeline.cli.help import Application
from wayside.pipeline.cli.running import EXIT_STATUSES, leave_stuck_viewer
from wayside.pipeline.running.process import (
    flush_standard_streams,
    in_words,
    interrupt_on_signals,
    open_standard_streams,
    report_error,
    silence_standard_streams,
)
from wayside.schemas.errors import INTERRUPTED, InterruptionError, UsageError, WaysideError

app = Application(
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    help="Road sign inventory from recorded drives: MCAP in, Parquet out.",
    epilog="Start with `wayside info drive.mcap`, then `wayside run drive.mcap -o out`.\n\n"
    + EXIT_STATUSES,
)
for group in (drive.app, running.app, result.app):
    app.add_typer(group)
app.add_typer(fleet.fleet_app, name="fleet", rich_help_panel=fleet.HEADING)
for group in (fleet.app, learning.app, planning.app):
    app.add_typer(group)


@app.callback(invoke_without_command=True)
def common(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
    debug: Annotated[
        bool,
        typer.Option("--debug", help="Print tracebacks. Works anywhere on the command line."),
    ] = False,
) -> None:
    """Options of every command."""
    if version:
        typer.echo(f"wayside {wayside.__version__}")
        raise typer.Exit


class WithoutPandas(MetaPathFinder):
    """Hides pandas, which pyarrow imports where it is installed, only to see whether it has made an array."""

    def find_spec(self, fullname: str, *_: object) -> None:
        """No command needs it; it takes 0.2 s and 40 MB."""
        if fullname == "pandas":
            raise ModuleNotFoundError(name=fullname)


def main() -> None:
    """The command line; every error ends here with its words and exit status."""
    sys.meta_path.insert(0, WithoutPandas())
    debug = "--debug" in sys.argv[1:]
    line = [word for word in sys.argv[1:] if word != "--debug"]
    open_standard_streams()
    interrupt_on_signals()
    try:
        answer = app(line, standalone_mode=False)
        status = answer if isinstance(answer, int) else 0
        if status == INTERRUPTED:  # what the parser makes of Ctrl-C
            raise InterruptionError("interrupted")
        flush_standard_streams()
    except KeyboardInterrupt:
        status = report_error(InterruptionError("interrupted"), debug=debug)
    except WaysideError as error:
        status = report_error(error, debug=debug)
    except OSError as error:
        status = report_error(in_words(error), debug=debug)
    except Exception as error:
        show = getattr(error, "show", None)
        if not callable(show):
            raise
        show()  # the parser's own words for wrong arguments
        status = UsageError.exit_status
    silence_standard_streams()
    leave_stuck_viewer(status)
    sys.exit(status)
