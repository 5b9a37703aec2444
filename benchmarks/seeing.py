"""Recall on rendered drives by height of the face and by stage; reliability of the confidence.

    OMP_NUM_THREADS=1 .venv/bin/python benchmarks/seeing.py [--only NAME]

Runs preset `default` as shipped on each drive that `make accept` measures, with all regions listed; then again with a
landmark classifier that refuses hardly anything. Writes benchmarks/seeing.md; with --only it prints the page.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
from accept import RENDERED
from common import BENCHMARKS, DRIVES, render, table, versions
from numpy.typing import NDArray

from wayside.pipeline.evaluation.figures import (
    ConfidenceBin,
    RenderedEvaluation,
    confidence_bin,
    together,
)
from wayside.pipeline.evaluation.rendered import (
    SMALLEST_HEIGHT_PX,
    SMALLEST_VISIBLE,
    evaluate_against_truth,
    is_eligible,
)
from wayside.pipeline.files.lengths import parse_length
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.running.run import RunRequest, run_log
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS
from wayside.stages.geometry import iou_matrix

HEIGHTS = (10, 12, 15, 20, 25, 35, 50, 100)
ON_FACE = 0.5
"""Overlap (IoU) from which a box shows the face."""
HARDLY_ANY = -12.0
"""Log odds below which the landmark classifier refuses, where rows of low confidence are wanted."""
BINS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
NOWHERE, CANDIDATE, CLASSIFIED, PASSED, KEPT, SIGN = range(6)
"""No box on the face; a box; one that is classified; the classifier's; not suppressed; part of a sign."""
STAGES = (CANDIDATE, CLASSIFIED, PASSED, SIGN)
HEAD = ("faces", "candidate", "classified", "passed classifier", "part of a sign", "of wanted")
REACHED = {"score": CLASSIFIED, "overlap": PASSED, "sign": SIGN}
REACHED |= dict.fromkeys(("size", "color", "shape"), CANDIDATE)
"""How far a candidate of each verdict went; all other verdicts are given to boxes that were followed."""

Row = dict[str, Any]
Result = tuple[list[Row], Row]
"""Rows of `signs.parquet` and the truth of the drive."""


@dataclass(frozen=True, slots=True)
class FaceOutcome:
    """The front of a sign in one image, and how far its candidates went; `wanted`: it is seen in images enough."""

    height_px: float
    wanted: bool
    level: int


def main() -> int:
    """Run, count, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", choices=RENDERED, help="this drive only")
    chosen = parser.parse_args().only
    names = [name for name in RENDERED if not chosen or name in chosen]
    cv2.setNumThreads(1)
    render(names)
    with tempfile.TemporaryDirectory() as scratch:
        lenient = [result_of(name, Path(scratch), HARDLY_ANY) for name in names]
        shipped = [result_of(name, Path(scratch), None) for name in names]
        faces = [face for name in names for face in faces_of(name, Path(scratch) / name)]
    lines = [*face_lines(faces), *confidence_lines(lenient, shipped)]
    if chosen:
        print("\n".join(lines))
    else:
        (BENCHMARKS / "seeing.md").write_text("\n".join(lines) + "\n")
    return 0


def result_of(name: str, folder: Path, threshold: float | None) -> Result:
    """Rows of `signs.parquet` except backs, all regions listed, and the truth.

    `threshold` replaces that of the landmark classifier.
    """
    spacing = RENDERED[name]
    options = {"read.spacing_m": parse_length(spacing)} if spacing else {}
    settings, _ = load_settings("default", None, [], options | {"run.workers": 1})
    models = load_models(settings)
    if threshold is not None and models.landmark_classifier is not None:
        landmark = replace(models.landmark_classifier, threshold=threshold)
        models = replace(models, landmark_classifier=landmark)
    out = folder / name
    run_log(RunRequest(DRIVES / f"{name}.mcap", out, settings, models, every_region=True))
    print(name, file=sys.stderr, flush=True)
    rows = pq.read_table(out / SIGNS.file).to_pylist()
    return [row for row in rows if row["status"] != "back"], truth_of(name)


def truth_of(name: str) -> Row:
    """The truth of a drive."""
    truth: Row = json.loads((DRIVES / f"{name}.truth.json").read_text())
    return truth


def faces_of(name: str, out: Path) -> Iterator[FaceOutcome]:
    """What the tables of a run say about the faces of its drive."""
    listed = pq.read_table(out / OBSERVATIONS.file, columns=["frame", "box", "verdict"])
    frames = pq.read_table(out / FRAMES.file, columns=["frame", "status"]).to_pylist()
    frame = np.asarray(listed["frame"])
    boxes = np.array(listed["box"].to_pylist(), np.float64).reshape(-1, 4)
    verdicts = np.array(listed["verdict"].to_pylist())
    rows = {
        f["frame"]: np.flatnonzero(frame == f["frame"]) for f in frames if f["status"] == "used"
    }
    for sign, view in fronts(truth_of(name)):
        if view["frame"] in rows:
            own = rows[view["frame"]]
            level = reached(view["box"], boxes[own], verdicts[own])
            height_px = view["box"][3] - view["box"][1]
            yield FaceOutcome(height_px, is_eligible(sign), level)


def fronts(truth: Row) -> Iterator[tuple[Row, Row]]:
    """Signs with their views that should be seen: the front, tall and visible enough."""
    for sign in truth["signs"]:
        for view in sign["frames"]:
            tall = view["box"][3] - view["box"][1] >= SMALLEST_HEIGHT_PX
            visible = (view["visible_fraction"] or 0.0) >= SMALLEST_VISIBLE
            if sign["faces_travel"] and view["side"] == "front" and tall and visible:
                yield sign, view


def reached(
    box: Sequence[float], boxes: NDArray[np.floating[Any]], verdicts: NDArray[np.str_]
) -> int:
    """The last step passed by the best candidate (`boxes` (n, 4), `verdicts` (n,)) that overlaps the face `box`."""
    if len(boxes) == 0:
        return NOWHERE
    on = iou_matrix(np.asarray(box, np.float64)[None], boxes)[0] >= ON_FACE
    return max((REACHED.get(str(verdict), KEPT) for verdict in verdicts[on]), default=NOWHERE)


def shares(levels: Iterable[int], stages: Iterable[int]) -> list[str]:
    """How many faces there are, and the fraction of them that went so far, in per cent, as cells of a table."""
    known = list(levels)
    counts = [sum(level >= stage for level in known) for stage in stages]
    return [str(len(known)), *(f"{100 * n / len(known):.0f} %" if known else "-" for n in counts)]


def bin_of(value: float, edges: Sequence[float]) -> int:
    """Number of the bin that starts at the last edge not above a value; -1 below all of them."""
    return int(np.searchsorted(np.asarray(edges), value, side="right")) - 1


def bin_names(edges: Sequence[float], unit: str) -> list[str]:
    """Names of the bins that start at the edges; the last has no end."""
    named = [f"{low:g}-{high:g} {unit}" for low, high in pairwise(edges)]
    return [*named, f"{edges[-1]:g} {unit} and more"]


def height_rows(faces: Sequence[FaceOutcome]) -> Iterator[list[str]]:
    """One line a height that has faces, and one for all."""
    names = bin_names(HEIGHTS, "px")
    for name in (*names, "**all**"):
        own = [f for f in faces if name in (names[bin_of(f.height_px, HEIGHTS)], "**all**")]
        if own:
            wanted = shares((face.level for face in own if face.wanted), (SIGN,))[1:]
            yield [name, *shares((face.level for face in own), STAGES), *wanted]


def face_lines(faces: Sequence[FaceOutcome]) -> list[str]:
    """The part of the page on faces."""
    return [
        "# Recall by face",
        "",
        "Made by `python benchmarks/seeing.py`, preset `default`, on the rendered drives that `make accept` measures; "
        "no model was learned from them. A face is the front of a sign in one image, at least half visible.",
        "",
        versions(),
        "",
        "## By height of the face",
        "",
        "*candidate*: a box on it (IoU .5), if necessary after box regression. Then *classified*, *passed classifier*: "
        "one above the threshold of that model. And *part of a sign*: one that is part of a row of `signs.parquet`. "
        "Signs seen in fewer than three images are not wanted, and many large faces are where a drive begins: *of "
        "wanted* is the same without them.",
        "",
        *table(("height", *HEAD), height_rows(faces)),
    ]


def evaluated_at(results: Sequence[Result], confidence: float) -> RenderedEvaluation:
    """All drives together, by their rows of at least that confidence."""
    return together(
        evaluate_against_truth([row for row in rows if row["confidence"] >= confidence], truth)
        for rows, truth in results
    )


def reliability(results: Sequence[Result]) -> Iterator[ConfidenceBin]:
    """Rows by confidence, and how many are true; a row is matched only against those of its bin and above."""
    for low, high in pairwise(BINS):
        false = {sign["sign_id"] for sign in evaluated_at(results, low).false}
        rows = (row for rows, _ in results for row in rows)
        stated = ((row["confidence"], row["sign_id"] not in false) for row in rows)
        yield confidence_bin(stated, low, high)


def confidence_lines(lenient: Sequence[Result], shipped: Sequence[Result]) -> list[str]:
    """The part of the page on the confidence: `lenient` with hardly a landmark refused, `shipped` as a run reports."""
    rows = []
    for one in reliability(lenient):
        e = evaluated_at(lenient, one.low)
        own = [f"{one.mean:.2f}", f"{one.right}"] if one.rows else ["-", "-"]
        counts = [f"{e.found_count} of {e.wanted}", len(e.false)]
        rows.append([f"{one.low:g}-{one.high:g}", one.rows, *own, *counts])
    e = evaluated_at(shipped, 0.5)
    return [
        "",
        "## Confidence",
        "",
        "Measured with a very low threshold of the landmark classifier, so that rows of low confidence are written. A "
        "run rejects them, or lists them as `uncertain` below `locate.confidence`. A *true* row is on a panel of its "
        "own. The last two columns count what rows of a bin and above it give, as `locate.confidence` chooses. As "
        f"shipped, .5 gives {e.found_count} of {e.wanted} found and {len(e.false)} false.",
        "",
        *table(("confidence", "rows", "mean", "true", "found", "false"), rows),
    ]


if __name__ == "__main__":
    sys.exit(main())
