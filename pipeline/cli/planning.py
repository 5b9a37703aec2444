"""The commands for settings, the planning of surveys and the figures of the report. Heavy imports stand inside."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from wayside.pipeline.cli.help import Application, examples
from wayside.pipeline.cli.options import Overwrite, parse_size, settings_of, takes
from wayside.pipeline.files.lengths import parse_length
from wayside.pipeline.files.visible_text import visible
from wayside.schemas.errors import UsageError

app = Application()


@app.command(epilog=examples("wayside settings --preset report > mine.toml"))
@takes("preset", "settings", "assignments")
def settings(
    every: Annotated[
        bool,
        typer.Option("--all", help="Also where each default is from."),
    ] = False,
    **given: Any,
) -> None:
    """Print the settings: value, unit, default, where it comes from. The output is a settings file."""
    from wayside.pipeline.files.settings_file import format_settings, load_settings

    chosen, origins = load_settings(
        given["preset"].value, given["settings"], given["assignments"] or [], {}
    )
    typer.echo(format_settings(chosen, origins, full=every), nl=False)


@app.command(
    epilog=examples(
        "wayside simulate --spacing 26.4ft --hfov 60",
        "wayside simulate --target 10cm",
        "wayside simulate --curve-radius 250m --hill 6m --outliers 0.05",
        "wayside simulate --pose-sigma 2cm --json plan.json",
    )
)
def simulate(
    spacing: Annotated[str, typer.Option(help="Distance between images: 26.4ft, 8m.")] = "26.4ft",
    focal_px: Annotated[
        float | None, typer.Option("--focal-px", help="Focal length, pixels.  [default: 1400]")
    ] = None,
    hfov: Annotated[
        float | None, typer.Option(help="Horizontal angle of view, degrees, instead.")
    ] = None,
    picture: Annotated[str, typer.Option(help="Size of an image, pixels.")] = "1600x1200",
    noise_px: Annotated[
        float,
        typer.Option("--noise-px", help="Error of a panel's centre in an image, a coordinate."),
    ] = 0.3,
    range_min: Annotated[str, typer.Option(help="Signs are not seen nearer than this.")] = "0m",
    lateral: Annotated[
        str, typer.Option(help="Signs stand this far right of the camera.")
    ] = "3.5m",
    panel: Annotated[str, typer.Option(help="Side of a panel.")] = "30in",
    curve_radius: Annotated[str | None, typer.Option(help="Drive a curve: 250m.")] = None,
    hill: Annotated[str, typer.Option(help="Height of hills, 400 m long.")] = "0m",
    jitter: Annotated[float, typer.Option(help="Scatter of the camera's pitch, degrees.")] = 0.1,
    trigger_sigma: Annotated[str, typer.Option(help="Scatter of the spacing.")] = "2cm",
    drop_rate: Annotated[float, typer.Option(help="Fraction of images that are missing.")] = 0.0,
    outliers: Annotated[
        float, typer.Option(help="Fraction of gross errors among ties and panels.")
    ] = 0.0,
    mount_yaw: Annotated[float, typer.Option(help="Camera turned right, degrees.")] = 0.0,
    mount_pitch: Annotated[float, typer.Option(help="Camera turned up, degrees.")] = 0.0,
    pose_sigma: Annotated[
        str | None,
        typer.Option(help="Poses are given, with this error: 2cm. Without it only the spacing is."),
    ] = None,
    signs: Annotated[int, typer.Option(help="How many signs.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 1,
    target: Annotated[
        str | None,
        typer.Option(
            help="Try spacings and focal lengths around these: which locate 95 % of signs within 10cm?"
        ),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Plan a survey: print how accurately signs would be located, or which spacing and focal length a target takes.

    Drives are simulated without images: panels and ties are projected with the given errors. The stages of `wayside
    run` locate the panels. The errors are compared with the stated sigmas and the Cramér-Rao bound.
    """
    from wayside.pipeline.cli.progress import SheetProgress
    from wayside.pipeline.files.writing import holding, require_free
    from wayside.pipeline.running.tuning import watched_compilation
    from wayside.pipeline.simulation.drive import Survey
    from wayside.pipeline.simulation.simulate import (
        OWN_KEYS,
        SimulationResult,
        check,
        focal_of_view,
        format_simulation,
        simulate,
        sweep,
        sweep_conclusion,
        sweep_heading,
        sweep_row,
        write_simulation,
    )

    if json is not None:
        require_free(json, is_own=holding(OWN_KEYS), overwrite=overwrite)
    width, height = parse_size(picture, "--picture", 64, 20_000)
    if focal_px is not None and hfov is not None:
        raise UsageError("--focal-px and --hfov state the same thing. Leave one out.")
    focal = (
        focal_of_view(hfov, width) if hfov is not None else 1400.0 if focal_px is None else focal_px
    )
    survey = Survey(
        spacing_m=parse_length(spacing, "--spacing"),
        focal_px=focal,
        width=width,
        height=height,
        noise_px=noise_px,
        range_min_m=parse_length(range_min, "--range-min"),
        lateral_m=parse_length(lateral, "--lateral"),
        panel_m=parse_length(panel, "--panel"),
        curve_radius_m=float("inf")
        if curve_radius is None
        else parse_length(curve_radius, "--curve-radius"),
        hill_m=parse_length(hill, "--hill"),
        jitter_deg=jitter,
        trigger_m=parse_length(trigger_sigma, "--trigger-sigma"),
        drop_rate=drop_rate,
        outliers=outliers,
        mount_yaw_deg=mount_yaw,
        mount_pitch_deg=mount_pitch,
        pose_m=None if pose_sigma is None else parse_length(pose_sigma, "--pose-sigma"),
        signs=signs,
        seed=seed,
    )

    def say(words: str) -> None:
        print(words, flush=True)  # above the bar, where both go to one terminal

    tried: list[SimulationResult] = []
    with SheetProgress("simulated", "images") as progress, watched_compilation(progress.compiling):
        if target is None:
            tried.append(simulate(survey, progress.watch))
            say(format_simulation(tried[0]))
        else:
            wanted = parse_length(target, "--target")
            check(survey)
            say(sweep_heading(wanted))
            for one in sweep(survey):
                with suppress(UsageError):  # no sign is seen
                    tried.append(simulate(one, progress.watch))
                    say(sweep_row(tried[-1], wanted))
            say(sweep_conclusion(tried, wanted))
    if json is not None:
        write_simulation(tried, json, overwrite=overwrite)


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
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of report_figures.html.")],
    labels: Annotated[
        Path | None,
        typer.Option(
            help="Labels of its images; see docs/labels.md.  "
            "[default: LOG.truth.json, LOG.labels.json or LOG.labels.parquet beside it]"
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
    """Make the figures of the report KS-09-9 on a drive, each number next to the report's, as one page."""
    from wayside.pipeline.report_figures.command import write_figures
    from wayside.pipeline.running.tuning import tune_process

    if (boards is None) != (board is None):
        raise UsageError(
            "--boards and --board are given together or not at all. A board of 10 x 7 squares is --board 9x6."
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
