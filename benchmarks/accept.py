"""Measure recall, precision and accuracy on drives with known signs, and fail below the floor.

    .venv/bin/python benchmarks/accept.py [--only NAME ...] [--preset report ...]

Renders the development drives once into .cache/drives, and runs both presets on each and on real drives where they are
at hand. Evaluates every result, and writes benchmarks/accuracy.md and benchmarks/accuracy_real.md. A rendered drive
that a model was learned from is refused; a real one has a table of its own. Speed is printed only: it belongs to the
machine. With --only or --preset nothing is written.
"""

import json
import sys
import tomllib
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from checked_boxes import with_checked_boxes
from common import BENCHMARKS, DRIVES, REAL_DRIVES, RESULTS, render, run_wayside, table, versions
from real_tables import Counts, RealDrive, counts_by_confidence, real_page

from wayside.pipeline.evaluation.compare import evaluate, write_evaluation
from wayside.pipeline.evaluation.figures import (
    Evaluation,
    RealEvaluation,
    RenderedEvaluation,
    together,
)
from wayside.pipeline.statistics import Spread
from wayside.schemas.errors import WaysideError

FLOOR = BENCHMARKS / "floor.toml"
PRESETS = ("default", "report")
EARLIER = ("report-2d", "report-shape")
"""Presets that are measured where they are asked for, and have no floor."""
RENDERED = {"demo": "", "straight": "", "curve": "", "town": "", "report": "26.4ft", "raw": ""}
"""Development drives with the spacing that a run is given, where the log has no poses."""
REAL = {
    "de_road_kitti0015": "6.15m",
    "us_freeway_challenge": "7.6m",
    "us_freeway_white_right": "6.1m",
    "ca_city_garmin": "",
    "de_city_kitti0001": "2.25m",
    "de_autobahn": "5.43m",
    "us_freeway_yellow_left": "5.9m",
    "kr_gantry": "5.5m",
    "de_residential_kitti03a": "",
}
"""Real drives and their spacing, estimated from the images; "": the log has fixes or poses."""
WITHOUT = BENCHMARKS / "models_without"
"""Models that were learned without a real drive, in a folder of its name: they measure it."""


@dataclass(frozen=True)
class BenchmarkDrive:
    """A log with its truth, the spacing that a run is given, and models other than those that ship."""

    name: str
    log: Path
    truth: Path
    spacing: str
    models: Path | None = None


@dataclass(frozen=True)
class Outcome:
    """A drive and its figures, without an evaluation where the run failed.

    Rows of a real drive on a sign that its labels leave out are `unlabelled`; they are right in `evaluation`. The
    `counts` of a real drive are at each of `CONFIDENCES`, where the preset states any.
    """

    drive: BenchmarkDrive
    evaluation: Evaluation | None
    unlabelled: int = 0
    counts: tuple[Counts, ...] = ()


def main() -> int:
    """Run, evaluate, write, compare with the floor."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=(*RENDERED, *REAL), metavar="NAME")
    parser.add_argument("--preset", action="append", choices=(*PRESETS, *EARLIER))
    parser.add_argument("--jobs", type=int, default=2, help="drives rendered at once")
    args = parser.parse_args()

    render([n for n in RENDERED if not args.only or n in args.only], args.jobs)
    drives = [rendered_drive(name, spacing) for name, spacing in RENDERED.items()]
    drives += real_drives(REAL_DRIVES)
    chosen = [drive for drive in drives if not args.only or drive.name in args.only]
    outcomes = {
        preset: [evaluate_drive(one, preset) for one in with_models_without(chosen, preset)]
        for preset in args.preset or PRESETS
    }
    if not (args.only or args.preset):
        write_tables(outcomes)
    broken = list(unfit(outcomes))
    if not args.only:
        broken += below_floor(outcomes)
    for line in broken:
        print(f"NOT ACCEPTED  {line}")
    return 1 if broken else 0


def with_models_without(drives: Iterable[BenchmarkDrive], preset: str) -> Iterator[BenchmarkDrive]:
    """The drives; those with models learned without them appear a second time, for preset `default`."""
    for drive in drives:
        yield drive
        folder = WITHOUT / drive.name
        if preset == "default" and folder.is_dir():
            yield replace(drive, name=f"{drive.name}, models without it", models=folder)


def rendered_drive(name: str, spacing: str) -> BenchmarkDrive:
    """A rendered drive by its name."""
    return BenchmarkDrive(name, DRIVES / f"{name}.mcap", DRIVES / f"{name}.truth.json", spacing)


def real_drives(folder: Path) -> Iterator[BenchmarkDrive]:
    """The real drives that are at hand."""
    for name, spacing in REAL.items():
        if (folder / f"{name}.mcap").is_file():
            labels = folder / f"{name}.labels.json"
            yield BenchmarkDrive(name, folder / f"{name}.mcap", labels, spacing)


def evaluate_drive(drive: BenchmarkDrive, preset: str) -> Outcome:
    """Run one preset on one drive in a process of its own, compare with the truth, print a line."""
    out = RESULTS / preset / drive.name
    words = ["--preset", preset, *(["--spacing", drive.spacing] if drive.spacing else [])]
    words += ["--models", str(drive.models)] if drive.models else []
    done = run_wayside("run", drive.log, "-o", out, "--overwrite", *words)  # it may be a new drive
    title = f"{preset:8} {drive.name:24}"
    if done.returncode != 0:
        last = done.stderr.strip()[-2000:]
        print(f"{title} run ended with status {done.returncode}\n{last}", flush=True)
        return Outcome(drive, None)
    try:
        evaluation, unlabelled, counts = evaluate(out, drive.truth), 0, ()
        if isinstance(evaluation, RealEvaluation):
            labels = checked_truth(drive)
            checked = evaluate(out, labels)
            counts = counts_by_confidence(out, json.loads(labels.read_text(encoding="utf-8")))
            unlabelled = len(evaluation.false) - len(checked.false)
            # boxes of one sign in several images are several labels there, and hide duplicates
            evaluation = replace(checked, duplicates=evaluation.duplicates)
        write_evaluation(evaluation, out / "evaluation.json")
    except WaysideError as error:
        print(f"{title} {error}", flush=True)
        return Outcome(drive, None)
    print(title, in_short(evaluation), flush=True)
    return Outcome(drive, evaluation, unlabelled, counts)


def checked_truth(drive: BenchmarkDrive) -> Path:
    """Labels of a real drive with the signs that they leave out."""
    labels = json.loads(drive.truth.read_text(encoding="utf-8"))
    path = RESULTS / "labels" / drive.truth.name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(with_checked_boxes(labels, drive.log.stem)), encoding="utf-8")
    return path


def in_short(evaluation: Evaluation) -> str:
    """Recall and precision with their counts; duplicates are false on rendered drives, not on real ones."""
    twice = len(evaluation.duplicates)
    among = "of them" if isinstance(evaluation, RenderedEvaluation) else "beside them"
    return (
        f"recall {evaluation.recall:.3f} ({evaluation.found_count}/{evaluation.wanted})  "
        f"precision {evaluation.precision:.3f} ({len(evaluation.false)} false, {among} {twice} duplicates)"
    )


def below_floor(outcomes: dict[str, list[Outcome]]) -> Iterable[str]:
    """Figures of all rendered drives together that are below `floor.toml`, in words."""
    floor = tomllib.loads(FLOOR.read_text())
    for preset, by_drive in outcomes.items():
        total = together(rendered(by_drive))
        print(f"{preset:8} {'rendered drives together':24} {in_short(total)}")
        for figure, value in (("recall", total.recall), ("precision", total.precision)):
            if value < floor.get(preset, {}).get(figure, 0.0):
                yield f"{preset}: {figure} {value:.4f} is below the floor of {floor[preset][figure]}"


def unfit(outcomes: dict[str, list[Outcome]]) -> Iterable[str]:
    """Drives that measure nothing, in words: runs that failed, and rendered drives that a model was learned from."""
    for preset, by_drive in outcomes.items():
        for outcome in by_drive:
            e, name = outcome.evaluation, outcome.drive.name
            if e is None:
                yield f"{preset}: {name} could not be evaluated"
            elif isinstance(e, RenderedEvaluation) and e.learned_by:
                yield f"{preset}: {', '.join(e.learned_by)} learned from {name}"


def rendered(outcomes: Iterable[Outcome]) -> list[RenderedEvaluation]:
    """Evaluations of rendered drives."""
    return [o.evaluation for o in outcomes if isinstance(o.evaluation, RenderedEvaluation)]


def write_tables(outcomes: dict[str, list[Outcome]]) -> None:
    """Write the tables of both pages; of the real drives only where they were at hand."""
    titled = {f"Preset `{preset}`": by_drive for preset, by_drive in outcomes.items()}
    write_page("accuracy.md", {title: rendered_table(o) for title, o in titled.items()})
    # the presets of the report miss too many to list them
    pages = {t: real_page(real(o), causes="default" in t) for t, o in titled.items()}
    if any(pages.values()):
        write_page("accuracy_real.md", pages)


def write_page(name: str, parts: dict[str, list[str]]) -> None:
    """Replace all of a page from its line of versions on by parts with titles; what it says above stays."""
    path = BENCHMARKS / name
    said, _, _ = path.read_text(encoding="utf-8").partition("Versions: ")
    lines = (line for title, part in parts.items() for line in ("", f"## {title}", "", *part))
    path.write_text("\n".join([said + versions(), *lines, ""]), encoding="utf-8")


def rendered_table(outcomes: list[Outcome]) -> list[str]:
    """One line a drive, and one for all together."""
    head = (
        "drive wanted found recall precision false duplicates along lateral up width height "
        "colour shape backs"
    ).split()
    rows = [
        (o.drive.name, o.evaluation)
        for o in outcomes
        if isinstance(o.evaluation, RenderedEvaluation)
    ]
    rows.append(("**together**", together(evaluation for _, evaluation in rows)))
    return table(head, (rendered_cells(name, evaluation) for name, evaluation in rows))


def rendered_cells(name: str, e: RenderedEvaluation) -> list[str]:
    """Cells of one line."""
    shares = (e.class_right("color"), e.class_right("shape"))
    return [
        *map(str, (name, e.wanted, e.found_count)),
        *(f"{e.recall:.3f}", f"{e.precision:.3f}"),
        *map(str, (len(e.false), len(e.duplicates))),
        *(spread_cell(e.error_m[axis], 1.0) for axis in ("along", "lateral", "up")),
        *(spread_cell(error, 100.0) for error in map(e.size_error, ("width", "height"))),
        *("-" if share is None else f"{100 * share:.0f} %" for share in shares),
        f"{e.backs.right} of {e.backs.reported} / {e.backs.in_view}",
    ]


def spread_cell(spread: Spread, scale: float) -> str:
    """Median and 95th percentile, metres to the centimetre, per cent to a tenth."""
    if spread.median is None or spread.p95 is None:
        return "-"
    places = 2 if scale == 1.0 else 1
    return f"{scale * spread.median:.{places}f} / {scale * spread.p95:.{places}f}"


def real(outcomes: Iterable[Outcome]) -> list[RealDrive]:
    """Evaluations of real drives by their names."""
    return [
        RealDrive(o.drive.name, o.evaluation, o.unlabelled, o.counts)
        for o in outcomes
        if isinstance(o.evaluation, RealEvaluation)
    ]


if __name__ == "__main__":
    sys.exit(main())
