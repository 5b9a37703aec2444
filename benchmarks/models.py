"""What the classifiers do on drives that their thresholds were not learned from: writes models.md.

    .venv/bin/python benchmarks/models.py DRIVE.mcap ... --default OTHER.mcap ...

Each drive needs its truth beside it. What the classifiers are asked about is kept in
.cache/models, one file a drive and preset. Every drive is held out in turn: thresholds and locations are learned from
the others. The drives of `--default` are those that the classifiers of preset `default` are asked about: none that they
were learned from.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.labels import read_labels
from wayside.pipeline.learning.asked import (
    NO_CLASS,
    TRAJECTORIES,
    ClassifierSamples,
    gather_samples,
    join_drives,
)
from wayside.pipeline.learning.curves import ALL, RocCurve
from wayside.pipeline.learning.gates import (
    CHAINS,
    KANSAS,
    learn_gates,
    trajectory_densities,
)
from wayside.pipeline.learning.samples import ANY_SPACING_M, ON
from wayside.pipeline.model_files import REPORT_LOCATION, load_models
from wayside.pipeline.roc.command import characteristics, format_characteristics
from wayside.pipeline.settings_file import load_settings
from wayside.schemas.models import GaussianModel

ROOT = Path(__file__).resolve().parents[1]
KEPT, PAGE = ROOT / ".cache" / "models", ROOT / "benchmarks" / "models.md"
FILES = {
    "color": "color_rgb.json",
    "shape": "shape.json",
    "location": REPORT_LOCATION,
    "location (report-kansas)": KANSAS,
}
ELSEWHERE = """\
## Elsewhere

| what | page |
| --- | --- |
| recall and precision of the three generations, and what each gate removes | [generations.md](generations.md), \
[docs/report.md](../docs/report.md) |
| a refit from 50 labelled pictures, and what it changes | [docs/fit.md](../docs/fit.md#measured) |
| calibration against the truth and on real boards | [docs/calibration.md](../docs/calibration.md) |
| recall of preset `default` by colour and size of the face | [seeing.md](seeing.md) |
""".splitlines()
DEFAULT = ("detector", "landmark", "confidence")
RATES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
DRAWS = 1000

Drive = Mapping[str, ClassifierSamples]
Fold = tuple[Drive, dict[str, Any]]
"""A drive, and the models that were learned from the others."""


@dataclass(frozen=True)
class Counts:
    """tp, positives, fp, negatives of each held-out drive, (drives, 4)."""

    rows: NDArray[np.int64]

    def rates(self) -> str:
        """Both rates with bands that resample the drives."""
        if not self.rows[:, 1].sum():
            return "no sign | - | -"
        weight = np.random.default_rng(1).multinomial(
            len(self.rows), np.full(len(self.rows), 1 / len(self.rows)), DRAWS
        )
        drawn, total = weight @ self.rows, self.rows.sum(axis=0)
        words = [f"{total[1]}"]
        for k in (0, 2):
            share = drawn[drawn[:, k + 1] > 0]
            low, high = np.quantile(share[:, k] / share[:, k + 1], [0.025, 0.975])
            words.append(
                f"{100 * total[k] / max(total[k + 1], 1):.1f} % ({100 * low:.1f} to {100 * high:.1f})"
            )
        return " | ".join(words)


def main() -> None:
    """Gather, hold out each drive in turn, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drives", type=Path, nargs="+")
    parser.add_argument("--size", action="store_true", help="ask the size gate: twice the time")
    parser.add_argument("--default", type=Path, nargs="+", default=[])
    given = parser.parse_args()
    drives: dict[str, Drive] = {}
    for log in given.drives:
        drives[log.stem] = {}
        for preset, wanted in CHAINS.items():
            # regions before the size gate are the same in both chains
            also = ("size",) if given.size and preset == "report" else ()
            drives[log.stem] |= kept_samples(log, preset, (*wanted, *also))
    default = {log.stem: kept_samples(log, "default", DEFAULT) for log in given.default}
    PAGE.write_text("\n".join(page(drives, default)) + "\n", encoding="utf-8")


def kept_samples(log: Path, preset: str, only: Sequence[str]) -> Drive:
    """What the classifiers of a preset are asked about on a drive, from the cache where it is there."""
    kept = KEPT / f"{log.stem}.{preset}.pickle"
    if kept.is_file():
        return dict(pickle.loads(kept.read_bytes()))
    options = {"read.spacing_m": ANY_SPACING_M}
    settings = load_settings(preset, None, [], options)[0]
    found = gather_samples(
        log,
        read_labels(log.with_suffix(".truth.json")),
        settings,
        load_models(settings),
        undecided=trajectory_densities(options) if preset == "report" else (),
        only=only,
    )
    KEPT.mkdir(parents=True, exist_ok=True)
    kept.write_bytes(pickle.dumps(found))
    return found


def page(drives: Mapping[str, Drive], default: Mapping[str, Drive]) -> Iterator[str]:
    """The lines of models.md."""
    shape, models = (load_models(load_settings(preset)[0]) for preset in CHAINS)
    models = replace(models, shape_classes=shape.shape_classes)
    densities = trajectory_densities({})
    folds: list[Fold] = []
    for name, own in drives.items():
        print(name, flush=True)
        others = join_drives([one for other, one in drives.items() if other != name])
        learned = learn_gates(others, models, densities)
        folds.append((own, learned))
    yield "# Classifiers of the report on drives held out in turn"
    yield ""
    yield (
        "What each classifier is asked about when preset `report` runs: connected regions, and triangulated landmarks "
        "of all that passes the colours (no shape gate before them). Thresholds are the knee of the ROC, of shapes one "
        "knee for the gate; each drive is judged by thresholds, and places, learned from the other drives. In brackets "
        "95 % bands, which resample the drives. TPR: signs of the class that its test accepts; FPR: others that it "
        f"accepts. Rendered drives: {', '.join(drives)}, other seeds of the specifications that means and covariances "
        "were learned from. `benchmarks/models.py` writes this page; `wayside roc` measures other drives "
        "([docs/roc.md](../docs/roc.md))."
    )
    yield ""
    yield "| classifier | class | signs | TPR | FPR |"
    yield "| --- | --- | ---: | --- | --- |"
    for classifier, file in FILES.items():
        asked = classifier.partition(" ")[0]
        usable = [(own[asked], learned[file]) for own, learned in folds if asked in own]
        names = [one.name for one in usable[0][1].classes] if asked != "location" else []
        for name in [ALL, *names]:
            yield f"| {classifier} | {name} | {Counts(held_out(usable, name)).rates()} |"
    together = join_drives(drives.values())
    yield ""
    yield from _beside_the_report(together, folds)
    yield ""
    yield from _retraded(folds)
    yield ""
    yield from trajectory_beside_location(folds)
    yield ""
    if default:
        yield from _by_evidence(default)
        yield ""
    yield from ELSEWHERE


def held_out(
    usable: Sequence[tuple[ClassifierSamples, GaussianModel]], name: str
) -> NDArray[np.int64]:
    """Counts (drives, 4) of a class, or of the classifier as a whole, by models that do not know the drive."""
    rows = []
    for every, model in usable:
        own = every.known()
        reach = np.array([one.threshold for one in model.classes])
        within = model.distances(own.values) <= reach
        on = own.label == ON
        if name == ALL:
            accepted = within.any(axis=1)
        else:
            accepted = within[:, [one.name for one in model.classes].index(name)]
        wanted = on & ((own.kind == name) | (name == ALL) | (own.kind == NO_CLASS))
        counted = (wanted & accepted, wanted, ~on & accepted, ~on)
        rows.append([int(own.count[flags].sum()) for flags in counted])
    return np.array(rows, np.int64)


def _beside_the_report(together: Drive, folds: Sequence[Fold]) -> Iterator[str]:
    settings = load_settings("report")[0]
    asked = {name: together[name] for name in ("size", "color") if name in together}
    measured = characteristics(asked, settings, load_models(settings))
    found = {
        (question.classifier, question.name): curve
        for question, curve in measured.curves
        if curve is not None
    }
    yield "## Beside the report"
    yield ""
    yield "| claim | report | here |"
    yield "| --- | --- | --- |"
    green = found["color", "green"]
    yield (
        "| others passed where all green signs are found (ch. 10) | 1.8 % | "
        f"{_others_at(green, 1.0)} at full TPR, {_others_at(green, 0.95)} at 95 % of {green.positives} views |"
    )
    shapes = [(own["shape"], learned["shape.json"]) for own, learned in folds if "shape" in own]
    tp, signs = held_out(shapes, ALL)[:, :2].sum(axis=0)
    yield (
        f"| shapes right of 50 images (ch. 4) | 92 % | {100 * tp / signs:.0f} % of {signs} views that reach the gate, "
        "any shape, irregular outlines among them |"
    )
    size, gate = found.get(("size", "smallest")), settings.gate
    if size is None:
        return
    kept = size.at(gate.smallest_px, accept_below=False)
    yield (
        f"| signs dropped below {gate.smallest_px} px (3.1) | - | {100 * (1 - size.tpr[kept]):.0f} % of "
        f"{size.positives} views of at least 8 px height; {100 * (1 - size.fpr[kept]):.1f} % of the other regions |"
    )


def trajectory_beside_location(folds: Sequence[Fold]) -> Iterator[str]:
    """What the gates of chapters 5 and 8 make of the same tracks."""
    yield "## Trajectory against location"
    yield ""
    yield (
        "The report replaced the trajectory in the image (chapter 5) by the place (chapters 8, 11). Both are asked "
        "about the same tracks, of regions of an accepted colour."
    )
    yield ""
    yield "| gate | signs | TPR | FPR |"
    yield "| --- | ---: | --- | --- |"
    counts: dict[str, list[list[int]]] = {}
    for own, learned in folds:
        places, mixture = own["location"].known(), learned[REPORT_LOCATION]
        reach = np.array([one.threshold for one in mixture.classes])
        stands = (mixture.distances(places.values) <= reach).any(axis=1)
        on = places.label == ON
        gates = {"location": stands}
        for name in TRAJECTORIES.values():
            tracks = own[name].known()
            if len(tracks) != len(places) or (tracks.box != places.box).any():
                raise SystemExit("wanted the same tracks before both gates, found others")
            moves = tracks.values[:, 0] >= learned[f"{name}.json"].threshold
            gates |= {name: moves, f"{name} and location": moves & stands}
        for name, accepted in gates.items():
            flags = (on & accepted, on, ~on & accepted, ~on)
            counts.setdefault(name, []).append([int(one.sum()) for one in flags])
    for name, rows in counts.items():
        yield f"| {name.replace('_', ', ')} | {Counts(np.array(rows, np.int64)).rates()} |"
    false, others = np.array(counts["location"], np.int64).sum(axis=0)[2:]
    yield ""
    yield (
        f"At the false positive rate of the location, {100 * false / others:.0f} %, no threshold lets the trajectory "
        f"keep more than {_most_kept([own for own, _ in folds], false / others)} of the signs."
    )


def _most_kept(drives: Sequence[Drive], rate: float) -> str:
    """The largest true positive rates of the trajectories at a false positive rate, in words."""
    words = []
    for form, name in TRAJECTORIES.items():
        own = ClassifierSamples.joined([drive[name] for drive in drives]).known()
        score, on = own.values[:, 0], own.label == ON
        least = np.quantile(score[~on], 1 - rate, method="higher")
        words.append(f"{100 * (score[on] > least).mean():.0f} % ({form})")
    return " or ".join(words)


def _by_evidence(drives: Mapping[str, Drive]) -> Iterator[str]:
    """The classifiers of preset `default`."""
    settings = load_settings("default")[0]
    together = join_drives(drives.values())
    yield "## Preset `default`"
    yield ""
    yield (
        "Boxes, landmarks by the sum of their evidence and by each of its terms, and the final confidence, on drives "
        f"that nothing was learned from: {', '.join(drives)}."
    )
    yield ""
    yield format_characteristics(characteristics(together, settings, load_models(settings)))


def _others_at(curve: RocCurve, tpr: float) -> str:
    row = int(np.argmax(curve.tpr >= tpr))
    return f"{100 * curve.fpr[row]:.1f} %"


def _retraded(folds: Sequence[Fold]) -> Iterator[str]:
    yield "## What the location allows"
    yield ""
    yield (
        "Landmarks of drives held out, by the operating points of the mixture and of the report's single mean; "
        "precision: landmarks of signs among those accepted (several may be of one sign). This is the curve of recall "
        "against precision that `--alpha` moves along."
    )
    yield ""
    yield "| rule | mixture: TPR | FPR | precision | report-kansas: TPR | FPR | precision |"
    yield "| --- | ---: | ---: | ---: | ---: | ---: | ---: |"
    for alpha in (None, *RATES):
        cells = []
        for file in (REPORT_LOCATION, KANSAS):
            usable = [
                (own["location"], learned[file] if alpha is None else learned[file].at_alpha(alpha))
                for own, learned in folds
            ]
            tp, signs, fp, others = held_out(usable, ALL).sum(axis=0)
            precision = f"{100 * tp / (tp + fp):.0f} %" if tp + fp else "-"
            cells += [f"{100 * tp / signs:.0f} %", f"{100 * fp / others:.1f} %", precision]
        yield f"| {'knee' if alpha is None else f'alpha {alpha:g}'} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
