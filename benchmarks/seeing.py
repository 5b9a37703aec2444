"""Recall on rendered drives by height of the face and by stage; reliability of the confidence.

    OMP_NUM_THREADS=1 .venv/bin/python benchmarks/seeing.py [--only NAME]

Runs preset `default` as shipped on each drive that `make accept` measures, with all regions listed; then again with a
landmark classifier that refuses hardly anything. Writes benchmarks/seeing.md; with --only it prints the page.
"""

import json
import sys
import tempfile
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
from accept import RENDERED, write_page
from common import DRIVES, render, table
from numpy.typing import NDArray

from wayside.pipeline.evaluation import rendered
from wayside.pipeline.evaluation.figures import (
    ConfidenceBin,
    RenderedEvaluation,
    confidence_bin,
    together,
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
FACE_HEADS = "height|faces|candidate|classified|passed classifier|part of a sign|of wanted".split(
    "|"
)
CONFIDENCE_HEADS = "confidence|rows|mean|true|found|false".split("|")
REACHED = {"score": CLASSIFIED, "overlap": PASSED, "sign": SIGN}
REACHED |= dict.fromkeys(("size", "color", "shape"), CANDIDATE)
"""How far a candidate of each verdict went; all other verdicts are given to boxes that were followed."""

Row = dict[str, Any]
Results = Sequence[tuple[list[Row], Row]]
"""Of each drive the rows of `signs.parquet`, and the truth."""


@dataclass(frozen=True, slots=True)
class FaceOutcome:
    """The front of a sign in one image, and how far its candidates went; `wanted`: it is seen in images enough."""

    height_px: float
    wanted: bool
    level: int


def main() -> int:
    """Run, count, write."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=RENDERED, help="this drive only")
    chosen = parser.parse_args().only
    names = [name for name in RENDERED if not chosen or name in chosen]
    cv2.setNumThreads(1)
    render(names)
    with tempfile.TemporaryDirectory() as scratch:
        lenient = [result_of(name, Path(scratch), HARDLY_ANY) for name in names]
        shipped = [result_of(name, Path(scratch), None) for name in names]
        faces = [
            face
            for name, (_, truth) in zip(names, shipped, strict=True)
            for face in faces_of(truth, Path(scratch) / name)
        ]
    parts = {
        "By height of the face": table(FACE_HEADS, height_rows(faces)),
        "Confidence": table(CONFIDENCE_HEADS, confidence_rows(lenient, shipped)),
    }
    if chosen:
        print("\n".join(line for part in parts.values() for line in part))
    else:
        write_page("seeing.md", parts)
    return 0


def result_of(name: str, folder: Path, threshold: float | None) -> tuple[list[Row], Row]:
    """Rows of `signs.parquet` except backs, all regions listed, and the truth.

    `threshold` replaces that of the landmark classifier.
    """
    spacing = RENDERED[name]
    options = {"read.spacing_m": parse_length(spacing, "--spacing")} if spacing else {}
    settings, _ = load_settings("default", None, [], options | {"run.workers": 1})
    models = load_models(settings)
    if threshold is not None and models.landmark_classifier is not None:
        landmark = replace(models.landmark_classifier, threshold=threshold)
        models = replace(models, landmark_classifier=landmark)
    out = folder / name
    run_log(RunRequest(DRIVES / f"{name}.mcap", out, settings, models, every_region=True))
    print(name, file=sys.stderr, flush=True)
    rows = pq.read_table(out / SIGNS.file).to_pylist()
    truth = json.loads((DRIVES / f"{name}.truth.json").read_text())
    return [row for row in rows if row["status"] != "back"], truth


def faces_of(truth: Row, out: Path) -> Iterator[FaceOutcome]:
    """What the tables of a run say about the faces of a drive."""
    listed = pq.read_table(out / OBSERVATIONS.file, columns=["frame", "box", "verdict"])
    used = pq.read_table(out / FRAMES.file, filters=[("status", "=", "used")])["frame"].to_pylist()
    frame = np.asarray(listed["frame"])
    boxes = np.array(listed["box"].to_pylist(), np.float64).reshape(-1, 4)
    verdicts = np.array(listed["verdict"].to_pylist())
    rows = {k: np.flatnonzero(frame == k) for k in used}
    for sign, view in fronts(truth):
        if (own := rows.get(view["frame"])) is not None:
            level = reached(view["box"], boxes[own], verdicts[own])
            height_px = view["box"][3] - view["box"][1]
            yield FaceOutcome(height_px, rendered.is_eligible(sign), level)


def fronts(truth: Row) -> Iterator[tuple[Row, Row]]:
    """Signs with their views that should be seen: the front, tall and visible enough."""
    for sign in truth["signs"]:
        for view in sign["frames"]:
            tall = view["box"][3] - view["box"][1] >= rendered.SMALLEST_HEIGHT_PX
            visible = (view["visible_fraction"] or 0.0) >= rendered.SMALLEST_VISIBLE
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


def height_rows(faces: Sequence[FaceOutcome]) -> Iterator[list[str]]:
    """One line a height that has faces, and one for all."""
    bins = {f"{low:g}-{high:g} px": (low, high) for low, high in pairwise(HEIGHTS)}
    bins |= {f"{HEIGHTS[-1]} px and more": (HEIGHTS[-1], np.inf), "**all**": (0, np.inf)}
    for name, (low, high) in bins.items():
        if own := [face for face in faces if low <= face.height_px < high]:
            wanted = shares((face.level for face in own if face.wanted), (SIGN,))[1:]
            yield [name, *shares((face.level for face in own), STAGES), *wanted]


def evaluated_at(results: Results, confidence: float) -> RenderedEvaluation:
    """All drives together, by their rows of at least that confidence."""
    return together(
        rendered.evaluate_against_truth([r for r in rows if r["confidence"] >= confidence], truth)
        for rows, truth in results
    )


def reliability(results: Results) -> Iterator[ConfidenceBin]:
    """Rows by confidence, and how many are true; a row is matched only against those of its bin and above."""
    for low, high in pairwise(BINS):
        false = {sign["sign_id"] for sign in evaluated_at(results, low).false}
        rows = (row for rows, _ in results for row in rows)
        stated = ((row["confidence"], row["sign_id"] not in false) for row in rows)
        yield confidence_bin(stated, low, high)


def confidence_rows(lenient: Results, shipped: Results) -> Iterator[list[object]]:
    """By confidence, with hardly a landmark refused (`lenient`); and what a run reports as it is shipped."""
    for one in reliability(lenient):
        own = [f"{one.mean:.2f}", one.right] if one.rows else ["-", "-"]
        yield [f"{one.low:g}-{one.high:g}", one.rows, *own, *found_cells(lenient, one.low)]
    yield ["**0.5-1 as shipped**", *"---", *found_cells(shipped, 0.5)]


def found_cells(results: Results, confidence: float) -> list[object]:
    """What rows of at least that confidence find, and how many are false."""
    e = evaluated_at(results, confidence)
    return [f"{e.found_count} of {e.wanted}", len(e.false)]


if __name__ == "__main__":
    sys.exit(main())
