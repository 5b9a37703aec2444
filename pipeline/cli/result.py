"""The commands that show, judge and pass on the result of a run. Heavy imports stand inside."""

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from wayside.pipeline.cli.help import Application, examples, remark
from wayside.pipeline.cli.options import (
    MovedLog,
    Option,
    Out,
    Overwrite,
    ReviewFiles,
    flag,
    parse_size,
    route_of,
    takes,
)
from wayside.pipeline.cli.running import require_page
from wayside.pipeline.files.visible_text import counted, visible, visible_lines
from wayside.schemas.errors import PARTS_LOST, InputError, UsageError

app = Application("Its result")
SignOption = Annotated[str | None, typer.Option("--sign", metavar="ID", help="ID of a sign.")]
OverOption = Annotated[
    Path | None,
    typer.Option(
        "--over",
        metavar="LOG",
        help="Show a recording that has no images over those of its log, which is imported once into OUT.",
    ),
]
FrameOption = Annotated[int | None, typer.Option("--frame", help="Number of a frame in the log.")]


Format = StrEnum("Format", ["csv", "xlsx", "geojson", "gpkg", "fgb", "shp", "kml", "kmz", "mcap"])
InventoryTable = StrEnum("InventoryTable", ["panels", "supports", "profile", "posts"])
HOW_TO_SHOW = {
    "png": flag("--png", "Also write each sheet as an image, to print or send."),
    "images": flag("--images", "Also write all images of the drive, to mark missing signs in."),
    "blur": flag("--blur", "Blur all but the sign panels in all images."),
}


@app.command(
    epilog=examples(
        "wayside evidence out",
        "wayside evidence out --sign drive-0007 -o sheets",
        "wayside evidence out --log /archive/drive.mcap",
    )
)
@takes("units", "route", "milepost", "decreasing", "routes", own=HOW_TO_SHOW)
def evidence(
    out: Out,
    sign: Annotated[
        str | None, typer.Option(metavar="ID", help="Write only this sign, without an index.")
    ] = None,
    log: MovedLog = None,
    folder: Annotated[
        Path | None, typer.Option("-o", "--out", help="Output folder; default: OUT/evidence.")
    ] = None,
    review: ReviewFiles = None,
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Write a page of images, maps and figures for every sign, and an index to filter and correct them."""
    from wayside.pipeline.cli.progress import SheetProgress
    from wayside.pipeline.evidence.marks import UNITS
    from wayside.pipeline.evidence.write import write_evidence
    from wayside.pipeline.running.tuning import tune_process

    tune_process()
    sheets = out / "evidence" if folder is None else folder
    if folder is None and sheets.is_symlink():
        raise UsageError(
            f"{sheets}: this is a link, and the sheets need a folder of their own. Name one with -o."
        )
    with SheetProgress("evidence") as progress:
        written = write_evidence(
            out,
            sheets,
            sign_id=sign,
            log=log,
            watch=progress.watch,
            **{name: given[name] for name in HOW_TO_SHOW},
            reviews=review or (),
            units=UNITS[given["units"].value],
            route=route_of(given),
            overwrite=overwrite,
        )
    index = f"{counted(len(written.sheets), 'sheet')}; open {written.index}"
    _note(written.notes)
    typer.echo(visible(str(written.sheets[0]) if written.index is None else index))
    if written.lost_views:
        remark(
            f"wayside: {counted(written.lost_views, 'view has', 'views have')} no image: the log no longer has "
            "it, or it cannot be decoded; its place on the sheet is empty"
        )
        raise typer.Exit(PARTS_LOST)


@app.command(
    epilog=examples(
        "wayside check out --only height --road rural",
        "wayside check out --rules mutcd --rules ours.toml",
    )
)
def check(
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Folder written by `wayside run` or `fleet`.")
    ],
    rules: Annotated[
        list[str] | None,
        typer.Option(help="mutcd, or a TOML file. Later rules replace those of the same name."),
    ] = None,
    only: Annotated[str, typer.Option(help="Check only rules whose name starts with this.")] = "",
    road: Annotated[str | None, typer.Option(help="Kind of road: rural, urban or freeway.")] = None,
    log: MovedLog = None,
    overwrite: Overwrite = False,
) -> None:
    """Check signs against placement rules. Lists those that fail; writes checks.html and checks.parquet to OUT."""
    from wayside.pipeline.checking.rules import ROADS, read_rules
    from wayside.pipeline.exporting.table import is_inventory
    from wayside.pipeline.fleet.folders import open_inventory
    from wayside.pipeline.fleet.manifest import DRIVES
    from wayside.pipeline.running.tuning import tune_process

    tune_process()
    asked = [rule for rule in read_rules(rules or ["mutcd"]) if rule.id.startswith(only)]
    if not asked:
        raise UsageError(f"--only {only}: no rule has a name that starts with this")
    if road not in (None, *ROADS):
        raise UsageError(f"--road {road}: the kinds of road are {', '.join(ROADS)}")
    drives = [out]
    if is_inventory(out):
        drives = [out / DRIVES / entry.name for entry in open_inventory(out).done()]
    if any([_check(drive, asked, road, log, overwrite=overwrite) for drive in drives]):
        raise typer.Exit(PARTS_LOST)


def _check(
    out: Path, rules: list[Any], road: str | None, log: Path | None, *, overwrite: bool
) -> bool:
    """Check one drive and print the result; whether images are lost."""
    from wayside.pipeline.checking.page import PAGE_FILE, write_page
    from wayside.pipeline.checking.verdicts import check_drive, format_checks, write_checks
    from wayside.pipeline.evidence.write import INDEX_FILE, write_evidence
    from wayside.pipeline.results.result import RUN_FILE

    checks, index, fault = check_drive(out, rules, road), out / "evidence" / INDEX_FILE, ""
    write_checks(checks, out, overwrite=overwrite)
    try:  # sheets of an earlier run show other signs
        if not index.exists() or index.stat().st_mtime < (out / RUN_FILE).stat().st_mtime:
            write_evidence(out, index.parent, log=log)
    except InputError as error:
        fault = str(error)
    fault = write_page(out, rules, checks, log=log, overwrite=overwrite) or fault
    typer.echo(visible_lines(f"{format_checks(rules, checks)}\n\nopen {out / PAGE_FILE}"))
    if fault:
        remark(f"wayside: the page lacks images or evidence: {fault}")
    return bool(fault)


@app.command(
    epilog=examples(
        "wayside view out",
        "wayside view out --sign drive-0007",
        "wayside view out --serve --port 8080",
    )
)
@takes("serve", "port", heading="Options")
def view(
    out: Out,
    sign: SignOption = None,
    frame: FrameOption = None,
    over: OverOption = None,
    **given: Any,
) -> None:
    """Open the recording of a run, at a sign or a frame."""
    from wayside.pipeline.view.results import find_target, open_result

    serve, port = given["serve"], given["port"]
    require_page(serve, port)
    target = find_target(out, sign, frame)
    open_result(out, target, over, serve=serve, web_port=port)
    # a page opens at the start, whatever is asked for
    where = "go to it in the time panel: frame" if serve else "frame"
    typer.echo(visible(f"{out}: {where} {target.frame}"))


@app.command(
    epilog=examples(
        "wayside picture out --sign drive-0007 -o sign.png",
        "wayside picture out --frame 12 -o frame.png",
    )
)
def picture(
    out: Out,
    png: Annotated[Path, typer.Option("-o", "--out", help="The PNG to write.")],
    sign: SignOption = None,
    frame: FrameOption = None,
    over: OverOption = None,
    size: Annotated[str, typer.Option(help="Width x height, pixels.")] = "1600x1000",
    overwrite: Overwrite = False,
) -> None:
    """Render the viewer to a PNG without a display, at a sign or a frame."""
    from wayside.pipeline.view.results import find_target, save_screenshot

    target, pixels = find_target(out, sign, frame), parse_size(size, "--size", 200, 8000)
    save_screenshot(out, target, over, png, pixels, overwrite=overwrite)
    typer.echo(visible(f"{png}"))


HOW_TO_EXPORT = {
    "file": Option(
        Path,
        "The file to write.  [default: signs.FORMAT in OUT; for an inventory TABLE.FORMAT]",
        names=("-o", "--out"),
    ),
    "kind": Option(Format, "Default: by the file extension.", names=("-f", "--format")),
    "table": Option(
        InventoryTable,
        "For an inventory: panels or supports; for a drive: profile or posts.  [default: panels; signs]",
    ),
    "crs": Option(
        str, "csv, gpkg, shp: coordinate reference system.  [default: WGS 84]", metavar="EPSG:..."
    ),
    "log": Option(Path, "mcap, --pictures: where the log is now, if it has moved."),
    "all_columns": flag("--all", "Write all columns instead of the twenty most useful."),
    "pictures": flag("--pictures", "gpkg, kmz: include the best image of each sign."),
    "accepted": flag("--accepted", "Leave out rows that the review rejects."),
}


@app.command(
    epilog=examples(
        "wayside export out -o signs.csv",
        "wayside export out -f gpkg --units us --crs EPSG:26914",
        "wayside export out -o signs.geojson --review ann.json --review bob.json --accepted",
        "wayside export out -f mcap -o drive.signs.mcap",
        "wayside export out -f csv --route 'US-36 EB' --milepost 12.35",
        "wayside export out -f csv --routes network.gpkg",
        "wayside export inventory -f gpkg --table supports",
    )
)
@takes("units", "route", "milepost", "decreasing", "routes", own=HOW_TO_EXPORT)
def export(
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="Folder written by `wayside run`, or an inventory of `wayside fleet`.",
        ),
    ],
    review: ReviewFiles = None,
    overwrite: Overwrite = False,
    **given: Any,
) -> None:
    """Export the signs for other programs, with corrections next to the measured values."""
    from wayside.pipeline.exporting.export import export as write
    from wayside.pipeline.exporting.table import is_inventory
    from wayside.pipeline.reviewing.matching import NO_REVIEW
    from wayside.pipeline.reviewing.review import find_review

    chosen = _format_of(given["file"], given["kind"])
    inventory, table = is_inventory(out), given["table"]
    name = table or ("panels" if inventory else "signs")
    target = given["file"] or out / f"{name}.{chosen}"
    if inventory and (review or given["accepted"]):
        raise UsageError(
            f"--review, --accepted: {out} is an inventory, and reviews are of one drive. Leave them out."
        )
    said = NO_REVIEW if inventory else find_review(out, review or ())
    how = {name: given[name] for name in ("crs", "log", "pictures", "accepted")}
    how |= {"table": table and table.value, "units": given["units"].value}
    how |= {"every": given["all_columns"], "route": route_of(given)}
    done = write(out, said, target, chosen, **how, overwrite=overwrite)
    reviewed = len(said.rows) + len(said.missing)
    more = f", {reviewed} of them reviewed" if reviewed else ""
    parts = "".join(f", {part.name}" for part in done.files if part != target)
    _note((*said.notes, *done.notes))
    typer.echo(visible(f"{target}{parts}: {counted(done.rows, 'row')}{more}"))


def _note(notes: Iterable[str]) -> None:
    for note in notes:
        remark(f"note: {note}")


def _format_of(file: Path | None, kind: Format | None) -> str:
    """The format that is asked for, else that of the file's name."""
    known = ", ".join(f".{one.value}" for one in Format)
    ending = "" if file is None else file.suffix.lower().removeprefix(".")
    if kind is not None:
        if kind is Format.shp and file is not None and ending != kind:
            raise UsageError(f"{file}: the name of a shapefile must end with .shp")
        return kind.value
    if ending not in [one.value for one in Format]:
        raise UsageError(
            f"{file or 'wayside export'}: the format is unknown. Give -f, or -o with one of the endings {known}."
        )
    return ending


@app.command(epilog=examples("wayside evaluate out --truth drive.truth.json --json figures.json"))
def evaluate(
    out: Out,
    truth: Annotated[
        Path,
        typer.Option(
            help="truth.json of a rendered drive, labels.json of a real one, or a review from the evidence index."
        ),
    ],
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Compare a result with ground truth."""
    from wayside.pipeline.reviewing.entries import is_review

    if is_review(truth):
        from wayside.pipeline.files.writing import write_json
        from wayside.pipeline.reviewing.review import find_review, format_figures, review_figures

        said = find_review(out, [truth])
        _note(said.notes)
        figures = review_figures(out, said)
        if json is not None:
            write_json(json, figures, ("reviewed", "accepted"), overwrite=overwrite)
        typer.echo(format_figures(figures))
        return
    from wayside.pipeline.evaluation.compare import evaluate as compare
    from wayside.pipeline.evaluation.compare import format_evaluation, other_log, write_evaluation

    evaluation = compare(out, truth)
    _note(filter(None, [other_log(out, truth)]))
    if json is not None:
        write_evaluation(evaluation, json, overwrite=overwrite)
    typer.echo(visible_lines(format_evaluation(evaluation)))
