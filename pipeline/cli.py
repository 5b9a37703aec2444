"""The command line. Heavy imports stand inside the commands, so that --help answers at once."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

import wayside
from wayside.pipeline import cli_boxes as boxes
from wayside.pipeline import cli_calibrating as calibrating
from wayside.pipeline import cli_changes as changing
from wayside.pipeline import cli_exporting as exporting
from wayside.pipeline import cli_fitting as fitting
from wayside.pipeline import cli_fleet as fleets
from wayside.pipeline import cli_importing as importing
from wayside.pipeline import cli_labelling as labelling
from wayside.pipeline import cli_planning as planning
from wayside.pipeline import cli_report_figures as figures
from wayside.pipeline import cli_roc as measuring
from wayside.pipeline import cli_routing as routing
from wayside.pipeline import cli_viewing as viewer
from wayside.pipeline.cli_help import DETECT, Application, Commands, examples
from wayside.pipeline.cli_options import (
    Assignments,
    Calibration,
    CameraTopic,
    Every,
    From,
    Memory,
    Preset,
    PresetOption,
    SettingsFile,
    Spacing,
    Until,
    Workers,
    chosen_settings,
    read_options,
)
from wayside.pipeline.cli_running import (
    EXIT_STATUSES,
    exit_with,
    process,
    process_all,
    read_as_log,
)
from wayside.pipeline.process import (
    flush_standard_streams,
    in_words,
    interrupt_on_signals,
    open_standard_streams,
    report_error,
    silence_standard_streams,
)
from wayside.pipeline.visible_text import fitted, visible, visible_lines
from wayside.schemas.errors import (
    INTERRUPTED,
    InterruptionError,
    UsageError,
    WaysideError,
)

app = Application(
    cls=Commands,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="Road sign inventory from recorded drives: MCAP in, Parquet out.",
    epilog="Start with `wayside info drive.mcap`, then `wayside run drive.mcap -o out`.\n\n"
    + EXIT_STATUSES,
)


class Listed(StrEnum):
    """Which regions become rows of observations.parquet."""

    passed = "passed"
    all = "all"


@app.callback(invoke_without_command=True)
def common(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
    debug: Annotated[
        bool,
        typer.Option("--debug", help="Show a traceback with every error; anywhere in the line."),
    ] = False,
) -> None:
    """Options of every command."""
    if version:
        typer.echo(f"wayside {wayside.__version__}")
        raise typer.Exit


@app.command(
    epilog=examples(
        "wayside run drive.mcap -o out",
        "wayside run images.mcap --spacing 26.4ft -o out",
        "wayside run drive.mcap --camera /front/image --from 1:30 --until 2:00 -o out",
        "wayside run drive.mcap --view file -o out",
        "wayside run drive.mcap --route 'US-36 EB' --milepost 12.35 -o out",
        "wayside run drive.mcap --detector yolo.onnx --classes classes.toml -o out",
        "wayside run drive.mcap --preset report --set segment.clusters=12 -o out",
    )
    + "\n\n"
    + EXIT_STATUSES
)
def run(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...", help="MCAP files, ROS 2 bag directories, ROS 1 bags."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", help="Output folder; with several logs, one folder each in it."
        ),
    ],
    spacing: Spacing = None,
    camera: CameraTopic = None,
    calibration: Calibration = None,
    start: From = None,
    until: Until = None,
    every: Every = None,
    preset: PresetOption = Preset.default,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    workers: Workers = None,
    memory: Memory = None,
    detector: boxes.Detector = None,
    detections: boxes.Detections = None,
    classes: boxes.Classes = None,
    models: fitting.Models = None,
    route: routing.Route = None,
    milepost: routing.Milepost = None,
    decreasing: routing.Decreasing = False,
    routes: routing.Routes = None,
    alpha: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=DETECT,
            help="False-alarm rate of every gate, instead of the thresholds of the models.",
        ),
    ] = None,
    observations: Annotated[
        Listed,
        typer.Option(
            rich_help_panel=DETECT,
            help="Regions to list: those that are classified, or all that pass the size gate.",
        ),
    ] = Listed.passed,
    view: viewer.ViewOption = viewer.ViewMode.none,
    connect: viewer.Connect = None,
    view_images: viewer.ViewImages = viewer.RecordedImages.all,
    view_detail: viewer.ViewDetail = False,
    overwrite: viewer.Overwrite = False,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Keep what is found in each image; go on where the same command was ended.",
        ),
    ] = False,
    verbose: viewer.Verbose = False,
) -> None:
    """Find the signs of a drive: LOG to a folder of Parquet tables."""
    if resume and (view is not viewer.ViewMode.none or connect is not None):
        raise UsageError(
            "wanted --resume or a viewer, which would miss images, found both; leave one out"
        )
    options = read_options(spacing, camera, calibration, start, until, every, workers, memory)
    options |= boxes.options(detector, detections, classes) | fitting.model_options(models)
    options |= routing.options(route, milepost, decreasing, routes, logs)
    if alpha is not None:
        options["models.alpha"] = alpha
    if detections is not None:
        boxes.require_one_log(logs)
    chosen = chosen_settings(preset, settings, assignments, options)
    viewing = viewer.viewing_of(view, connect, view_images, view_detail)
    every_region = observations is Listed.all
    folders = [out if len(logs) == 1 else out / log.stem for log in logs]
    process_all(
        logs,
        folders,
        chosen,
        viewing,
        every_region=every_region,
        overwrite=overwrite,
        resume=resume,
        verbose=verbose,
    )


@app.command(
    epilog=examples(
        "wayside replay drive.mcap", "wayside replay drive.mcap --rate max --connect 127.0.0.1:9876"
    )
)
def replay(
    log: viewer.Log,
    rate: Annotated[str, typer.Option(help="Times the recorded speed: 1x, 0.5x, or max.")] = "1x",
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also keep the result in this folder.")
    ] = None,
    connect: viewer.Connect = None,
    serve: Annotated[bool, typer.Option(help="In the browser instead of a window.")] = False,
    preset: PresetOption = Preset.default,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    spacing: Spacing = None,
    camera: CameraTopic = None,
    calibration: Calibration = None,
    start: From = None,
    until: Until = None,
    workers: Workers = None,
    detector: boxes.Detector = None,
    detections: boxes.Detections = None,
    classes: boxes.Classes = None,
    models: fitting.Models = None,
    view_images: viewer.ViewImages = viewer.RecordedImages.all,
    view_detail: viewer.ViewDetail = False,
    overwrite: viewer.Overwrite = False,
) -> None:
    """Play a log through the whole flow into a live viewer, at the speed it was recorded at."""
    import tempfile

    options = read_options(spacing, camera, calibration, start, until, None, workers)
    options |= boxes.options(detector, detections, classes) | fitting.model_options(models)
    chosen = chosen_settings(preset, settings, assignments, options)
    times = viewer.parse_rate(rate)
    shown = viewer.ViewMode.serve if serve else viewer.ViewMode.live
    viewing = viewer.viewing_of(
        viewer.ViewMode.none if connect is not None else shown, connect, view_images, view_detail
    )
    with tempfile.TemporaryDirectory(prefix="wayside-") as scratch:
        folder = Path(scratch) if out is None else out
        end = process(
            read_as_log(log),
            folder,
            chosen,
            viewing,
            rate=times,
            kept=out is not None,
            overwrite=overwrite,
        )
    exit_with([end])


app.command(
    epilog=examples(
        "wayside view out", "wayside view out --sign drive-0007", "wayside view out --serve"
    )
)(viewer.view)
app.command(
    epilog=examples(
        "wayside picture out --sign drive-0007 -o sign.png",
        "wayside picture out --frame 12 -o frame.png",
    )
)(viewer.picture)


@app.command(epilog=examples("wayside info drive.mcap"))
def info(
    log: viewer.Log,
) -> None:
    """Say what a log holds, and whether and how it can be used."""
    from wayside.pipeline.information import describe_log, format_information

    words = visible_lines(format_information(describe_log(read_as_log(log), shown=log)))
    typer.echo(fitted(words) if sys.stdout.isatty() else words)


@app.command(epilog=examples("wayside evaluate out --truth drive.truth.json --json figures.json"))
def evaluate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder written by `wayside run`.")],
    truth: Annotated[
        Path,
        typer.Option(
            help="truth.json of a rendered drive, labels.json of a real one, or a review of the evidence index."
        ),
    ],
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
    overwrite: viewer.Overwrite = False,
) -> None:
    """Compare a result with the truth."""
    from wayside.pipeline.reviewing.review import is_review

    if is_review(truth):
        exporting.evaluate_review(out, truth, json, overwrite=overwrite)
        return
    from wayside.pipeline.evaluate import evaluate as compare
    from wayside.pipeline.evaluate import format_evaluation, other_log, write_evaluation

    evaluation = compare(out, truth)
    if (words := other_log(out, truth)) is not None:
        typer.echo(visible(f"note: {words}"), err=True)
    if json is not None:
        write_evaluation(evaluation, json, overwrite=overwrite)
    typer.echo(visible_lines(format_evaluation(evaluation)))


@app.command(epilog=examples("wayside settings --preset report > mine.toml"))
def settings(
    preset: PresetOption = Preset.default,
    file: SettingsFile = None,
    assignments: Assignments = None,
    every: Annotated[bool, typer.Option("--all", help="Also where each default is from.")] = False,
) -> None:
    """Print the settings: value, unit, default, where it comes from. The output is a settings file."""
    from wayside.pipeline.settings_file import format_settings, load_settings

    chosen, origins = load_settings(preset.value, file, assignments or [], {})
    typer.echo(format_settings(chosen, origins, full=every), nl=False)


app.command(
    epilog=examples(
        "wayside evidence out",
        "wayside evidence out --sign drive-0007 -o sheets",
        "wayside evidence out --log /archive/drive.mcap",
    )
)(viewer.evidence)
app.command("import", epilog=importing.IMPORT_EPILOG)(importing.import_)
app.command(epilog=importing.JOIN_EPILOG)(importing.join)
app.command(epilog=planning.SIMULATE_EPILOG)(planning.simulate)
app.command(epilog=calibrating.CALIBRATE_EPILOG)(calibrating.calibrate)
app.command(epilog=fitting.FIT_EPILOG)(fitting.fit)
app.command(epilog=labelling.LABEL_EPILOG)(labelling.label)
app.command(epilog=exporting.EXPORT_EPILOG)(exporting.export)
app.command(epilog=changing.CHANGES_EPILOG)(changing.changes)
app.command(epilog=figures.REPORT_FIGURES_EPILOG)(figures.report_figures)
app.command(epilog=measuring.ROC_EPILOG)(measuring.roc)
app.add_typer(fleets.fleet_app, name="fleet")
app.command(epilog=fleets.QUERY_EPILOG)(fleets.query)


def main() -> None:
    """The command line; every error ends here with its words and exit status."""
    debug = "--debug" in sys.argv[1:]
    line = [word for word in sys.argv[1:] if word != "--debug"]
    open_standard_streams()
    interrupt_on_signals()
    try:
        result = app(line, standalone_mode=False)
        status = result if isinstance(result, int) else 0
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
    viewer.leave_stuck_viewer(status)
    sys.exit(status)
