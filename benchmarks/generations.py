"""The report's three generations, what their gates allow, and what the trajectory classifier removes.

    .venv/bin/python benchmarks/generations.py [--only NAME] [--keep] [--models FOLDER]

Runs the chains on the development and the held-out drives (rendered by `make accept` and `make held-out` into
.cache/drives) and writes benchmarks/generations.md and docs/generations.png, with the preset `default` beside them
where those left its results. The gates of `report-2d` and `report` are asked about the same tracks, so that one run of
a drive gives both presets and every threshold of their gates. Counts are kept in .cache/generations, one file a drive;
with --keep they are taken from there. With --only nothing is written.
"""

from __future__ import annotations

import argparse
import pickle
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
from accept import DRIVES, RENDERED, RESULTS, ROOT, spread_cell
from generations_plot import draw
from held_out import HELD_OUT

from wayside.pipeline.evaluation import (
    RenderedEvaluation,
    evaluate,
    evaluate_against_truth,
    together,
)
from wayside.pipeline.flow import Flow
from wayside.pipeline.learning.gates import trajectory_densities
from wayside.pipeline.learning.landmarks import NEITHER, SIGN
from wayside.pipeline.learning.samples import read_truth
from wayside.pipeline.learning.trajectories import Tracks, tracks_of
from wayside.pipeline.lengths import parse_spacing
from wayside.pipeline.model_files import Models, load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.rows import sign_row
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.statistics import share_interval
from wayside.pipeline.workers import Item, StageClock
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.models import GaussianModel, MixtureModel
from wayside.schemas.settings import Settings
from wayside.stages.georeference import DriveRecord, collect, georeference, place_signs
from wayside.stages.mapping import assemble, classify_location
from wayside.stages.report import classify_trajectory

KEPT = ROOT / ".cache" / "generations"
PAGE, PICTURE = ROOT / "benchmarks" / "generations.md", ROOT / "docs" / "generations.png"
DEVELOPMENT = tuple(name for name in RENDERED if name != "raw")
SETS = {"development": DEVELOPMENT, "held-out": tuple(HELD_OUT)}
SPACING = RENDERED | HELD_OUT
FORMS = ("image", "compensated")
PRESETS = ("report-shape", "report-2d", "report", "default")
RULES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""False-alarm rates of the curves; 0: the thresholds of the model, at the knee."""
GATES = (
    "location",
    "trajectory, image",
    "trajectory, compensated",
    "location and trajectory, compensated",
)


@dataclass(frozen=True, slots=True)
class Gated:
    """Tracks of signs and others before the trajectory classifier, and how many of each either form keeps."""

    signs: int
    others: int
    kept: dict[str, tuple[int, int]]


@dataclass(frozen=True, slots=True)
class Measured:
    """A drive: figures by preset, and by gate and rule (of `RULES`); what reached the trajectory."""

    presets: dict[str, RenderedEvaluation]
    gates: dict[tuple[str, float], RenderedEvaluation]
    gated: Gated


class TrackWatch:
    """Keeps what leaves the stage `track`: frames with their landmarks, before the gates of landmarks."""

    def __init__(self) -> None:
        self.frames: list[TrackedFrame] = []

    def see(self, stage: str, item: Item) -> None:
        """Take note of tracked frames."""
        if stage == "track" and isinstance(item, TrackedFrame):
            self.frames.append(item)


@dataclass(frozen=True, slots=True)
class Chain:
    """The tracks of a drive by one chain, and the settings that place and evaluate what gates leave of them."""

    name: str
    truth: dict[str, Any]
    settings: Settings
    frames: tuple[TrackedFrame, ...]

    def evaluation(
        self, trajectory: MixtureModel | None = None, location: GaussianModel | None = None
    ) -> RenderedEvaluation:
        """The figures with these gates: those of a run, whose later stages are asked again."""
        tracked, s = iter(self.frames), self.settings
        if trajectory is not None:
            tracked = classify_trajectory(tracked, model=trajectory)
        if location is not None:
            tracked = classify_location(tracked, model=location, settings=s.locate)
        record = DriveRecord()
        for _ in collect(assemble(tracked, settings=s.assembly), record=record):
            pass
        points = iter(record.points)
        (path,) = georeference(
            points, settings=s.georeference, motion=s.motion, landmark=s.landmark
        )
        signs = place_signs(
            iter(record.landmarks),
            path=path,
            settings=s.georeference,
            confidence=s.locate.confidence,
        )
        rows = [sign_row(sign, self.name) for sign in signs]
        return evaluate_against_truth([row for row in rows if row["status"] == "sign"], self.truth)


def main() -> int:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [name for own in SETS.values() for name in own]
    parser.add_argument("--only", action="append", choices=names, help="this drive only")
    parser.add_argument("--keep", action="store_true", help="take results that are there already")
    parser.add_argument("--models", default="", help="folder of models in place of those that ship")
    given = parser.parse_args()
    measured = {
        name: with_default(name, measure(name, given.models, keep=given.keep))
        for name in given.only or names
    }
    if not given.only:
        PAGE.write_text("\n".join(page(measured)) + "\n", encoding="utf-8")
        rgb = draw({name: curves(measured, own) for name, own in SETS.items()})
        cv2.imwrite(str(PICTURE), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    return 0


def measure(name: str, folder: str, *, keep: bool) -> Measured:
    """All figures of a drive, kept in a file."""
    kept = KEPT / f"{name}.pickle"
    if keep and kept.is_file():
        known = pickle.loads(kept.read_bytes())
        if isinstance(known, Measured):
            return known
    by_shape, (tracks, models) = run(name, "report-shape", folder)[0], run(name, "report", folder)
    densities = {one.space: one for one in trajectory_densities({"models.folder": folder})}
    presets = {
        "report-shape": by_shape.evaluation(),
        "report-2d": tracks.evaluation(densities["image"]),
        "report": tracks.evaluation(location=models.location_classes),
    }
    gates: dict[tuple[str, float], RenderedEvaluation] = {}
    for rule in RULES:
        by_place = models.location_classes.at_alpha(rule) if rule else models.location_classes
        gates["location", rule] = tracks.evaluation(location=by_place)
        for form, density in densities.items():
            if rule and not density.curve:
                continue  # a model without operating points
            moves = density.at_alpha(rule) if rule else density
            gates[f"trajectory, {form}", rule] = tracks.evaluation(moves)
            gates[f"location and trajectory, {form}", rule] = tracks.evaluation(moves, by_place)
    gated = gate(tracks_of(tracks.frames, tracks.truth), densities)
    measured = Measured(presets, gates, gated)
    KEPT.mkdir(parents=True, exist_ok=True)
    kept.write_bytes(pickle.dumps(measured))
    counts = {preset: (e.found_count, len(e.false)) for preset, e in presets.items()}
    print(name, counts, flush=True)
    return measured


def with_default(name: str, measured: Measured) -> Measured:
    """The same with the figures of preset `default`, where there is a result of it."""
    default = RESULTS / "default" / name
    if not (default / "run.json").is_file():
        return measured
    found = evaluate(default, DRIVES / f"{name}.truth.json")
    if not isinstance(found, RenderedEvaluation):
        return measured
    return replace(measured, presets=measured.presets | {"default": found})


def run(name: str, preset: str, folder: str) -> tuple[Chain, Models]:
    """A chain on a drive up to its tracks, with the gates of landmarks left open."""
    options = {
        "read.spacing_m": parse_spacing(SPACING[name]) if SPACING[name] else None,
        "models.folder": folder,
        "locate.gate": False,
    }
    settings, _ = load_settings(preset, None, [], options)
    models, watch = load_models(settings), TrackWatch()
    flow = Flow(settings, models, StageClock(), watch)
    log, truth = DRIVES / f"{name}.mcap", DRIVES / f"{name}.truth.json"
    for _ in flow.track(read_frames(log, settings.read, ReadReport())):
        pass
    return Chain(name, read_truth(truth), settings, tuple(watch.frames)), models


def gate(tracks: Tracks, densities: dict[str, MixtureModel]) -> Gated:
    """What either form of the trajectory classifier keeps of the tracks of a drive."""
    sign, other = tracks.label == SIGN, (tracks.label != SIGN) & (tracks.label != NEITHER)
    kept = {}
    for form, model in densities.items():
        passes = tracks.scores(model) >= model.threshold
        kept[form] = (int((passes & sign).sum()), int((passes & other).sum()))
    return Gated(int(sign.sum()), int(other.sum()), kept)


def curves(
    measured: Mapping[str, Measured], names: Sequence[str]
) -> dict[str, list[tuple[float, float]]]:
    """Recall and precision of drives together: a point for each preset, for each gate one for each rate."""
    found = {
        preset: [_point(together(one.presets[preset] for one in own))]
        for preset in PRESETS
        if (own := [measured[name] for name in names if preset in measured[name].presets])
    }
    for name in GATES:
        found[name] = [
            _point(together(measured[drive].gates[name, rule] for drive in names))
            for rule in RULES[1:]
            if all((name, rule) in measured[drive].gates for drive in names)
        ]
    return found


def page(measured: Mapping[str, Measured]) -> Iterator[str]:
    """Lines of the page."""
    yield "# The report's three generations"
    yield ""
    yield "Made by `python benchmarks/generations.py` on the development drives of [accuracy.md](accuracy.md) and on"
    yield "those of [accuracy_held_out.md](accuracy_held_out.md); no model was learned from any of them."
    yield "[docs/report.md](../docs/report.md) says what each preset does. False rows include duplicates; errors are"
    yield "medians and 95th percentiles; in brackets 95 % intervals of counts that are independent."
    for title, names in SETS.items():
        yield from _generations(title, {name: measured[name] for name in names})
    yield from _allowed(measured)
    yield from _trajectories(measured)


def _generations(title: str, drives: Mapping[str, Measured]) -> Iterator[str]:
    yield ""
    yield f"## {title.capitalize()} drives"
    yield ""
    yield "| drive | preset | panels | found | recall | false | precision | along, m | lateral, m |"
    yield "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
    for name, one in drives.items():
        for preset in PRESETS:
            if preset in one.presets:
                yield _line(name, preset, one.presets[preset])
    for preset in PRESETS:
        own = [one.presets[preset] for one in drives.values() if preset in one.presets]
        if len(own) == len(drives):
            yield _line("**together**", preset, together(own))


def _allowed(measured: Mapping[str, Measured]) -> Iterator[str]:
    yield ""
    yield "## What the gates allow"
    yield ""
    yield "Recall against precision as the gates of landmarks are given a false-alarm rate (as `--alpha` does), the"
    yield "colours staying at their knee: what a run finds of the same tracks. *knee*: by the thresholds of the models."
    yield ""
    yield "![Recall against precision, development and held-out drives](../docs/generations.png)"
    yield ""
    yield f"| gate | rate | {' | '.join(f'{name}: found | false | precision' for name in SETS)} |"
    yield f"| --- | ---: | {' | '.join(['---: | ---: | ---:'] * len(SETS))} |"
    for gate in GATES:
        for rule in RULES:
            if any((gate, rule) not in one.gates for one in measured.values()):
                continue
            cells = []
            for names in SETS.values():
                e = together(measured[name].gates[gate, rule] for name in names)
                cells.append(
                    f"{e.found_count} of {e.wanted} | {len(e.false)} | {_percent(e.precision)}"
                )
            yield f"| {gate} | {f'{rule:g}' if rule else 'knee'} | {' | '.join(cells)} |"


def _trajectories(measured: Mapping[str, Measured]) -> Iterator[str]:
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
    for title, names in SETS.items():
        rows = {name: measured[name].gated for name in names}
        rows[f"**{title}**"] = Gated(
            sum(one.signs for one in rows.values()),
            sum(one.others for one in rows.values()),
            {
                form: (
                    sum(one.kept[form][0] for one in rows.values()),
                    sum(one.kept[form][1] for one in rows.values()),
                )
                for form in FORMS
            },
        )
        for name, one in rows.items():
            kept = [_share(one.kept[form][0], one.signs) for form in FORMS]
            removed = [_share(one.others - one.kept[form][1], one.others) for form in FORMS]
            yield f"| {name} | {one.signs} | {' | '.join(kept)} | {one.others} | {' | '.join(removed)} |"


def _point(e: RenderedEvaluation) -> tuple[float, float]:
    return e.recall, e.precision


def _share(count: int, of: int) -> str:
    if not of:
        return "-"
    interval = share_interval(count, of)
    return f"{count}" if interval is None else f"{count} ({_range(interval)})"


def _range(interval: tuple[float, float]) -> str:
    return " to ".join(f"{100 * end:.0f}" for end in interval) + " %"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _line(name: str, preset: str, found: RenderedEvaluation) -> str:
    along, lateral = (spread_cell(found.error_m[axis], 1.0) for axis in ("along", "lateral"))
    recall = f"{found.recall:.2f}"
    if name.startswith("**") and found.recall_interval is not None:
        recall += f" ({_range(found.recall_interval)})"
    return (
        f"| {name} | `{preset}` | {found.wanted} | {found.found_count} | {recall} | {len(found.false)} | "
        f"{found.precision:.3f} | {along} | {lateral} |"
    )


if __name__ == "__main__":
    sys.exit(main())
