"""The last step that the candidates on a face passed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.statistics import share_interval
from wayside.stages.geometry import iou_matrix

ON_FACE = 0.5
"""Overlap (IoU) from which a box shows the face."""

NOWHERE, CANDIDATE, CLASSIFIED, PASSED, KEPT, SIGN = range(6)
"""No box on the face; a box; one that is classified; the classifier's; not suppressed; part of a sign."""

STOPPED = (
    "no candidate",
    "where the network sees no face",
    "rejected by the box classifier",
    "suppressed by another box",
    "not part of a reported sign",
)
"""Where a face stopped, by how far it went."""

_REACHED = {
    "size": CANDIDATE,
    "color": CANDIDATE,
    "shape": CANDIDATE,
    "score": CLASSIFIED,
    "overlap": PASSED,
    "sign": SIGN,
}
"""How far a candidate of each verdict went; all other verdicts are given to boxes that were followed."""


def reached(
    box: Sequence[float], boxes: NDArray[np.floating[Any]], verdicts: NDArray[np.str_]
) -> int:
    """The last step passed by the best candidate (`boxes` (n, 4), `verdicts` (n,)) that overlaps the face `box`."""
    if len(boxes) == 0:
        return NOWHERE
    on = iou_matrix(np.asarray(box, np.float64)[None], boxes)[0] >= ON_FACE
    return max((_REACHED.get(str(verdict), KEPT) for verdict in verdicts[on]), default=NOWHERE)


def shares(levels: Iterable[int], stages: Iterable[int], *, sure: bool = False) -> list[str]:
    """How many faces there are, and the fraction of them that went so far, in per cent, as cells of a table.

    With `sure`, both ends of its 95 % interval follow in brackets.
    """
    all_of = list(levels)
    counts = [sum(level >= stage for level in all_of) for stage in stages]
    return [str(len(all_of)), *(_share(count, len(all_of), sure=sure) for count in counts)]


def _share(count: int, total: int, *, sure: bool) -> str:
    interval = share_interval(count, total)
    if interval is None:
        return "-"
    ends = f" ({100 * interval.low:.0f} to {100 * interval.high:.0f})" if sure else ""
    return f"{100 * count / total:.0f} %{ends}"


def bin_of(value: float, edges: Sequence[float]) -> int:
    """Number of the bin that starts at the last edge not above a value; -1 below all of them."""
    return int(np.searchsorted(np.asarray(edges), value, side="right")) - 1


def bin_names(edges: Sequence[float], unit: str) -> list[str]:
    """Names of the bins that start at the edges; the last has no end."""
    named = [f"{low:g}-{high:g} {unit}" for low, high in pairwise(edges)]
    return [*named, f"{edges[-1]:g} {unit} and more"]


def table(head: Sequence[str], rows: Iterable[Sequence[str]], align: str = "---:") -> list[str]:
    """Lines of a table, the first column to the left, the others as `align` says."""
    return [
        "| " + " | ".join(head) + " |",
        "| --- |" + f" {align} |" * (len(head) - 1),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
