"""The commands for settings, the planning of surveys and the figures of the report. Heavy imports stand inside."""

import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayside.pipeline.cli.help import Application, examples
from wayside.pipeline.cli.options import Option, Overwrite, parse_size, set_by, settings_of, takes
from wayside.pipeline.files.lengths import parse_length
from wayside.pipeline.files.visible_text import visible
from wayside.schemas.errors import UsageError

if TYPE_CHECKING:
    from wayside.pipeline.simulation.drive import Survey
    from wayside.pipeline.simulation.simulate import SimulationResult

app = Application("Settings and planning")


@app.command(epilog=examples("wayside settings --preset report > mine.toml"))
@takes("preset", "settings", "assignments")
def settings(
    every: Annotated[bool, typer.Option("--all", help="Add the source of each default.")] = False,
    **given: Any,
) -> None:
    """Print the settings with value, unit, default and source. The output is a settings file."""
    from wayside.pipeline.files.settings_file import format_settings, load_settings

    chosen, origins = load_settings(
        given["preset"].value, given["settings"], given["assignments"] or [], {}
    )
    typer.echo(format_settings(chosen, origins, full=every), nl=False)


def _length(field: str, default: str | None, words: str) -> Option:
    return Option(str, words, field, default, parse_length)


SURVEY = {
    "spacing": _length("spacing_m", "26.4ft", "Distance between images: 26.4ft, 8m."),
    "focal_px": Option(float, "Focal length, pixels.  [default: 1400]", names=("--focal-px",)),
    "hfov": Option(float, "Horizontal angle of view, degrees, instead of --focal-px."),
    "picture": Option(str, "Size of an image, pixels.", default="1600x1200"),
    "noise_px": Option(
        float, "Error of a panel's centre in an image, per coordinate.", "noise_px", 0.3
    ),
    "range_min": _length("range_min_m", "0m", "Signs nearer than this are not seen."),
    "lateral": _length("lateral_m", "3.5m", "Signs stand this far right of the camera."),
    "panel": _length("panel_m", "30in", "Side of a panel."),
    "curve_radius": _length("curve_radius_m", None, "Drive a curve: 250m."),
    "hill": _length("hill_m", "0m", "Height of hills that are 400 m long."),
    "jitter": Option(float, "Scatter of the camera's pitch, degrees.", "jitter_deg", 0.1),
    "trigger_sigma": _length("trigger_m", "2cm", "Scatter of the spacing."),
    "drop_rate": Option(float, "Fraction of images that are missing.", "drop_rate", 0.0),
    "outliers": Option(float, "Fraction of gross errors among ties and panels.", "outliers", 0.0),
    "mount_yaw": Option(float, "Camera turned right, degrees.", "mount_yaw_deg", 0.0),
    "mount_pitch": Option(float, "Camera turned up, degrees.", "mount_pitch_deg", 0.0),
    "pose_sigma": _length(
        "pose_m", None, "Error of known poses: 2cm. Without it, only the spacing is known."
    ),
    "signs": Option(int, "Number of signs.", "signs", 200),
    "seed": Option(int, "Seed of the random numbers.", "seed", 1),
}
"""The options of `wayside simulate` that describe the survey, and the fields of `Survey` that they set."""


def _survey(given: Mapping[str, Any]) -> "Survey":
    """The survey that the options describe; raises UsageError."""
    from wayside.pipeline.simulation.drive import Survey
    from wayside.pipeline.simulation.simulate import focal_of_view

    width, height = parse_size(given["picture"], "--picture", 64, 20_000)
    focal, view = given["focal_px"], given["hfov"]
    if focal is not None and view is not None:
        raise UsageError("--focal-px and --hfov state the same thing. Leave one out.")
    if view is not None:
        focal = focal_of_view(view, width)
    fields = {"curve_radius_m": math.inf, "pose_m": None} | set_by(given, SURVEY)
    return Survey(focal_px=1400.0 if focal is None else focal, width=width, height=height, **fields)


@app.command(
    epilog=examples(
        "wayside simulate --spacing 26.4ft --hfov 60",
        "wayside simulate --target 10cm",
        "wayside simulate --curve-radius 250m --hill 6m --outliers 0.05",
        "wayside simulate --pose-sigma 2cm --json plan.json",
    )
)
@takes(own=SURVEY)
def simulate(
    target: Annotated[
        str | None,
        typer.Option(
            help="Find spacings and focal lengths that locate 95 % of signs within this: 10cm."
        ),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Also write the figures to this file.")] = None,
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Plan a survey: print how accurately signs would be located, or which spacing and focal length reach a target.

    Drives are simulated without images: panels and ties are projected with the given errors. The stages of `wayside
    run` locate the panels. The errors are compared with the stated sigmas and the Cramér-Rao bound.
    """
    from wayside.pipeline.cli.progress import SheetProgress
    from wayside.pipeline.files.writing import holding, require_free
    from wayside.pipeline.running.compilation import watched_compilation
    from wayside.pipeline.simulation import simulate as planning

    if json is not None:
        require_free(json, is_own=holding(planning.OWN_KEYS), overwrite=overwrite)
    survey = _survey(given)

    def say(words: str) -> None:
        print(words, flush=True)  # above the bar, where both go to one terminal

    tried: list[SimulationResult] = []
    with SheetProgress("simulated", "images") as progress, watched_compilation(progress.compiling):
        if target is None:
            tried.append(planning.simulate(survey, progress.watch))
            say(planning.format_simulation(tried[0]))
        else:
            wanted = parse_length(target, "--target")
            planning.check(survey)
            say(planning.sweep_heading(wanted))
            for one in planning.sweep(survey):
                with suppress(UsageError):  # no sign is seen
                    tried.append(planning.simulate(one, progress.watch))
                    say(planning.sweep_row(tried[-1], wanted))
            say(planning.sweep_conclusion(tried, wanted))
    if json is not None:
        planning.write_simulation(tried, json, overwrite=overwrite)


@app.command(
    "report-figures",
    epilog=examples(
        "wayside report-figures drive.mcap -o figures",
        "wayside report-figures drive.mcap --spacing 26.4ft -o figures",
        "wayside report-figures drive.mcap --labels labels.parquet --boards boards/ --board 9x6 -o figures",
    ),
)
@takes("spacing", "camera", "calibration", "assignments")
def report_figures(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The log of a drive.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for report_figures.html.")],
    labels: Annotated[
        Path | None,
        typer.Option(
            help="Labels of its images; see docs/labels.md.  "
            "[default: LOG.truth.json, LOG.labels.json or LOG.labels.parquet next to it]"
        ),
    ] = None,
    boards: Annotated[
        Path | None, typer.Option(help="Folder with images of a chessboard, for figure 6.1.")
    ] = None,
    board: Annotated[
        str | None, typer.Option(help="Inner corners along both sides of the chessboard: 9x6.")
    ] = None,
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Make the figures of report KS-09-9 for a drive on one page, each number next to the report's."""
    from wayside.pipeline.report_figures.command import write_figures
    from wayside.pipeline.running.tuning import tune_process

    if (boards is None) != (board is None):
        raise UsageError(
            "--boards and --board must be given together. A board of 10 x 7 squares is --board 9x6."
        )
    tune_process()
    page, figures = write_figures(
        log,
        out,
        labels=labels,
        boards=None if boards is None else [boards],
        board=board,
        assignments=given["assignments"],
        options=settings_of(given),
        overwrite=overwrite,
    )
    left_out = [figure.number for figure in figures if figure.needs]
    words = f"; left out: {', '.join(left_out)}" if left_out else ""
    typer.echo(visible(f"{page}: {len(figures) - len(left_out)} figures{words}"))
