"""List the cause of each missed and each false sign, from the results that `make accept` left.

    .venv/bin/python benchmarks/causes.py [RESULTS]

Reads RESULTS (.cache/accept/default unless given) and the truth of the rendered drives; writes benchmarks/causes.md.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from wayside.pipeline.evaluate import evaluate
from wayside.pipeline.evaluation import RenderedEvaluation
from wayside.stages.geometry import iou_matrix

ROOT = Path(__file__).resolve().parents[1]
DRIVES, RESULTS = ROOT / ".cache" / "drives", ROOT / ".cache" / "accept" / "default"
NAMES = ("demo", "straight", "curve", "town", "report", "raw")
ON_FACE = 0.5
"""Overlap (IoU) from which a candidate shows the face."""

WORDS = {
    "none": "no candidate on the face, or rejected by the pre-filter",
    "score": "rejected by the box classifier",
    "overlap": "assigned to another sign",
    "few_views": "detected in too few images",
    "unmatched": "detected in single images only",
    "place_score": "rejected by the landmark classifier",
}
"""What the most frequent verdict on a missed sign's views says; other verdicts say it by their name."""


def main() -> int:
    """Write the page."""
    results = Path(sys.argv[1]) if len(sys.argv) > 1 else RESULTS
    missed: list[tuple[str, str, str, str]] = []
    false: list[tuple[str, str, str, str]] = []
    named: list[tuple[str, str, str, str]] = []
    for name in NAMES:
        truth = DRIVES / f"{name}.truth.json"
        evaluation = evaluate(results / name, truth)
        if not isinstance(evaluation, RenderedEvaluation):
            continue
        known = json.loads(truth.read_text())
        missed += missed_rows(name, results / name, known, [m.id for m in evaluation.missed])
        for one in evaluation.false:
            kind = f"{one.color} {one.shape}, frame {one.best_frame}"
            false.append((name, one.sign_id, kind, f"on {one.cause}"))
        for match in evaluation.matches:
            for found, true in (match.color, match.shape):
                if found != true:
                    named.append((name, match.sign_id, true, f"named {found}"))
    (ROOT / "benchmarks" / "causes.md").write_text(page(missed, false, named))
    return 0


def missed_rows(
    name: str, out: Path, truth: dict[str, Any], ids: list[int]
) -> list[tuple[str, str, str, str]]:
    """Drive, sign, kind and cause of each missed sign: the most frequent verdict on the views that count."""
    table = pq.read_table(out / "observations.parquet", columns=["frame", "box", "verdict"])
    frames = np.asarray(table["frame"])
    boxes = np.array(table["box"].to_pylist(), np.float64).reshape(-1, 4)
    verdicts = np.array(table["verdict"].to_pylist())
    rows = []
    for sign in truth["signs"]:
        if sign["id"] not in ids:
            continue
        views = [
            verdict_on(np.array(v["box"]), boxes[own], verdicts[own])
            for v in sign["frames"]
            for own in [frames == v["frame"]]
            if (v["visible_fraction"] or 0) >= 0.5 and v["box"][3] - v["box"][1] >= 10
        ]
        count = Counter(views)
        cause = count.most_common(1)[0][0]
        said = ", ".join(f"{n} {verdict}" for verdict, n in count.most_common())
        rows.append(
            (name, str(sign["id"]), str(sign["kind"]), f"{WORDS.get(cause, cause)} ({said})")
        )
    return rows


def verdict_on(
    box: NDArray[np.float64], boxes: NDArray[np.float64], verdicts: NDArray[np.str_]
) -> str:
    """Verdict on the candidate that overlaps a true box most; "none" where there is none on it."""
    if len(boxes) == 0:
        return "none"
    overlap = iou_matrix(box[None], boxes)[0]
    best = int(overlap.argmax())
    return str(verdicts[best]) if overlap[best] >= ON_FACE else "none"


def page(*parts: list[tuple[str, str, str, str]]) -> str:
    """The page: a table for each part, with its count."""
    titles = ("Missed signs", "False signs", "Wrong colours and shapes")
    lines = [
        "# Causes of the remaining errors",
        "",
        "Made by `python benchmarks/causes.py` from the results of `make accept`, preset `default`. The cause of a",
        "missed sign is the most frequent verdict on its views (10 px tall, half visible), counted behind it.",
    ]
    for title, rows in zip(titles, parts, strict=True):
        lines += ["", f"## {title}: {len(rows)}", ""]
        if rows:
            lines += ["| drive | sign | what | cause |", "| --- | --- | --- | --- |"]
            lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
