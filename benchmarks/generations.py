"""The report's three generations, and what its trajectory classifier removes.

    .venv/bin/python benchmarks/generations.py [--only NAME] [--keep]

Runs the three on development drives (rendered by `make accept` into .cache/drives) and writes
benchmarks/generations.md, with the preset `default` beside them where `make accept` left its results. With --only
nothing is written; with --keep `report-shape` and `report` do not run again where .cache/accept has their results. The
tracks before and after the trajectory classifier are the report's figures 5.3 and 5.4, counted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from accept import (
    DRIVES,
    RENDERED,
    RESULTS,
    ROOT,
    BenchmarkDrive,
    Outcome,
    evaluate_drive,
    in_short,
    rendered,
    spread_cell,
)

import wayside
from wayside.pipeline.evaluate import evaluate
from wayside.pipeline.evaluation import RenderedEvaluation, together
from wayside.pipeline.learning.landmarks import NEITHER, SIGN
from wayside.pipeline.learning.samples import read_truth
from wayside.pipeline.learning.trajectories import Tracks, tracks_of
from wayside.pipeline.model_files import load_models
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.statistics import share_interval

NAMES = ("demo", "straight", "curve", "town", "report")
PRESETS = ("report-shape", "report-2d", "report")
FORMS = ("image", "compensated")
PAGE = ROOT / "benchmarks" / "generations.md"


@dataclass(frozen=True, slots=True)
class Gated:
    """Tracks of signs and others before the trajectory classifier, and how many of each either form keeps."""

    drive: str
    signs: int
    others: int
    kept: dict[str, tuple[int, int]]


def main() -> int:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", choices=NAMES, help="this drive only")
    parser.add_argument("--keep", action="store_true", help="take results that are there already")
    given = parser.parse_args()
    names = given.only or NAMES
    drives = [
        BenchmarkDrive(name, DRIVES / f"{name}.mcap", DRIVES / f"{name}.truth.json", RENDERED[name])
        for name in names
    ]
    gated, generation_2d = zip(*(run_2d(one) for one in drives), strict=True)
    outcomes = {
        preset: list(generation_2d)
        if preset == "report-2d"
        else [outcome(one, preset, keep=given.keep) for one in drives]
        for preset in PRESETS
    }
    results = RESULTS / "default"
    if all((results / name / "run.json").is_file() for name in names):
        outcomes["default"] = [outcome(one, "default", keep=True) for one in drives]
    if tuple(names) == NAMES:
        PAGE.write_text("\n".join(page(outcomes, gated)) + "\n", encoding="utf-8")
    return 0


def outcome(drive: BenchmarkDrive, preset: str, *, keep: bool) -> Outcome:
    """The figures of a preset on a drive."""
    out = RESULTS / preset / drive.name
    if not (keep and (out / "run.json").is_file()):
        return evaluate_drive(drive, preset)
    found = evaluate(out, drive.truth)
    print(f"{preset:12} {drive.name:10} {in_short(found)}", flush=True)
    return Outcome(drive, found)


def run_2d(drive: BenchmarkDrive) -> tuple[Gated, Outcome]:
    """The second generation on a drive, and what reached its trajectory gate."""
    out = RESULTS / "report-2d" / drive.name
    inventory = wayside.run(
        drive.log,
        preset="report-2d",
        spacing=drive.spacing or None,
        out=out,
        overwrite=True,
    )
    gated = gate(drive.name, tracks_of(inventory, read_truth(drive.truth)))
    print(gated, flush=True)
    return gated, outcome(drive, "report-2d", keep=True)


def gate(drive: str, tracks: Tracks) -> Gated:
    """What either form of the trajectory classifier keeps of the tracks of a drive."""
    sign, other = tracks.label == SIGN, (tracks.label != SIGN) & (tracks.label != NEITHER)
    kept = {}
    for form in FORMS:
        settings, _ = load_settings("report-2d", None, [f"report.trajectory={form}"])
        model = load_models(settings).trajectory_density
        if model is None:
            raise ValueError(f"wanted a model of the form {form}, found none")
        passes = tracks.scores(model) >= model.threshold
        kept[form] = (int((passes & sign).sum()), int((passes & other).sum()))
    return Gated(drive, int(sign.sum()), int(other.sum()), kept)


def page(outcomes: dict[str, list[Outcome]], gated: Sequence[Gated]) -> Iterator[str]:
    """Lines of the page."""
    yield "# The report's three generations"
    yield ""
    yield "Made by `python benchmarks/generations.py` on the development drives of [accuracy.md](accuracy.md), which no"
    yield "model was learned from and where `default` stands, too. [docs/report.md](../docs/report.md) says what each"
    yield "preset does. False rows include duplicates; errors are medians and 95th percentiles."
    yield ""
    yield "| drive | preset | panels | found | recall | false | precision | along, m | lateral, m |"
    yield "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
    names = [outcome.drive.name for outcome in next(iter(outcomes.values()))]
    for k, name in enumerate(names):
        for preset, by_drive in outcomes.items():
            found = rendered(by_drive[k : k + 1])
            if found:
                yield _line(name, preset, found[0])
    for preset, by_drive in outcomes.items():
        yield _line("**together**", preset, together(rendered(by_drive)))
    yield ""
    yield "## Before and after the trajectory classifier"
    yield ""
    yield 'The report shows one image before and after (figures 5.3 and 5.4): billboards and "typically all" false'
    yield "positives of colour go. Counted here are tracks of two or more views that pass the colour gate: those on the"
    yield "front of a sign, and those on nothing. *image* is the report's (u, v, du, dv), *compensated* the same"
    yield "without the rotation of the camera."
    yield ""
    yield "| drive | signs | kept, image | kept, compensated | others | removed, image | removed, compensated |"
    yield "| --- | ---: | ---: | ---: | ---: | ---: | ---: |"
    whole = Gated(
        "**together**",
        sum(one.signs for one in gated),
        sum(one.others for one in gated),
        {
            form: (
                sum(one.kept[form][0] for one in gated),
                sum(one.kept[form][1] for one in gated),
            )
            for form in FORMS
        },
    )
    for one in (*gated, whole):
        kept = [_share(one.kept[form][0], one.signs) for form in FORMS]
        removed = [_share(one.others - one.kept[form][1], one.others) for form in FORMS]
        yield f"| {one.drive} | {one.signs} | {' | '.join(kept)} | {one.others} | {' | '.join(removed)} |"


def _share(count: int, of: int) -> str:
    if not of:
        return "-"
    interval = share_interval(count, of)
    return f"{count}" if interval is None else f"{count} ({_percent(interval)})"


def _percent(interval: tuple[float, float]) -> str:
    return " to ".join(f"{100 * end:.0f}" for end in interval) + " %"


def _line(name: str, preset: str, found: RenderedEvaluation) -> str:
    along, lateral = (spread_cell(found.error_m[axis], 1.0) for axis in ("along", "lateral"))
    return (
        f"| {name} | `{preset}` | {found.wanted} | {found.found_count} | {found.recall:.2f} | {len(found.false)} | "
        f"{found.precision:.3f} | {along} | {lateral} |"
    )


if __name__ == "__main__":
    sys.exit(main())
