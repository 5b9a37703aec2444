"""List the cause of each missed and each false sign, from the results that `make accept` left.

    .venv/bin/python benchmarks/causes.py [RESULTS]

Reads RESULTS (.cache/accept/default unless given) and the truth of the rendered drives; writes benchmarks/causes.md.
The causes are those that `wayside evaluate` prints; those of real drives are in accuracy_real.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

from wayside.pipeline.evaluation import RenderedEvaluation, cause_words, evaluate

ROOT = Path(__file__).resolve().parents[1]
DRIVES, RESULTS = ROOT / ".cache" / "drives", ROOT / ".cache" / "accept" / "default"
NAMES = ("demo", "straight", "curve", "town", "report", "raw")

Line = tuple[str, str, str, str]


def main() -> int:
    """Write the page."""
    results = Path(sys.argv[1]) if len(sys.argv) > 1 else RESULTS
    missed: list[Line] = []
    false: list[Line] = []
    named: list[Line] = []
    for name in NAMES:
        evaluation = evaluate(results / name, DRIVES / f"{name}.truth.json")
        if isinstance(evaluation, RenderedEvaluation):
            missed += missed_lines(name, evaluation)
            false += false_lines(name, evaluation)
            named += named_lines(name, evaluation)
    (ROOT / "benchmarks" / "causes.md").write_text(page(missed, false, named))
    return 0


def missed_lines(name: str, evaluation: RenderedEvaluation) -> list[Line]:
    """Drive, sign, kind and cause of each missed sign."""
    pairs = zip(evaluation.missed, evaluation.causes, strict=True)
    return [(name, str(m.id), str(m.kind), cause_words(cause)) for m, cause in pairs]


def false_lines(name: str, evaluation: RenderedEvaluation) -> list[Line]:
    """Drive, row, what it is taken for and where it is of each false row."""
    of = {row.sign_id: row.better for row in evaluation.duplicates}
    lines = []
    for one in evaluation.false:
        kind = f"{one.color} {one.shape}, frame {one.best_frame}"
        twice = f"duplicate of {of[one.sign_id]}, " if one.sign_id in of else ""
        lines.append((name, one.sign_id, kind, f"{twice}on {one.cause}"))
    return lines


def named_lines(name: str, evaluation: RenderedEvaluation) -> list[Line]:
    """Drive, row, true class and given class where they differ."""
    return [
        (name, match.sign_id, true, f"named {found}")
        for match in evaluation.matches
        for found, true in (match.color, match.shape)
        if found != true
    ]


def page(*parts: list[Line]) -> str:
    """The page: a table for each part, with its count."""
    titles = ("Missed signs", "False signs", "Wrong colours and shapes")
    lines = [
        "# Causes of the remaining errors",
        "",
        "Made by `python benchmarks/causes.py` from the results of `make accept`, preset `default`. The cause of a",
        "missed sign is the last step that a candidate on it passed in any view (10 px tall, half visible); the",
        "verdicts on all of them are counted behind it.",
    ]
    for title, rows in zip(titles, parts, strict=True):
        lines += ["", f"## {title}: {len(rows)}", ""]
        if rows:
            lines += ["| drive | sign | what | cause |", "| --- | --- | --- | --- |"]
            lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
