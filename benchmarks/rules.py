"""Spacings, and verdicts of rules, on rendered drives against their truth.

`PYTHONPATH=. python benchmarks/rules.py OUT TRUTH [OUT TRUTH ...]` compares results with their truth files: each
stated spacing with the true one of the same two panels, and each verdict with that of the true values. A verdict is
wrong where the true value is on the other side of its limit: how far off it is in standard deviations is printed.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from common import table
from sign_codes import allowed

from recordings.drives.backdrop.cover import markings
from recordings.drives.spec import RoadSpec
from wayside.pipeline.checking.rules import read_rules
from wayside.pipeline.checking.verdicts import Check, check_drive, check_rows
from wayside.pipeline.evaluation.compare import evaluate
from wayside.pipeline.evaluation.figures import RenderedEvaluation
from wayside.pipeline.results.result import read_rows
from wayside.pipeline.statistics import sigma_share, spread
from wayside.schemas.sign_catalogue import SERIES, US
from wayside.schemas.tables import CHECK_VERDICTS, SIGNS

Row = Mapping[str, Any]
SAME = ("assembly_id", "color", "shape", "station_m", "lateral_m", "up_m", "bottom_m", "facing_deg")


def true_rows(truth: Row) -> list[dict[str, Any]]:
    """The panels of a truth that face the camera as rows of `signs.parquet`, without errors; `sign_id`: their ids."""
    panels = [panel for panel in truth["signs"] if panel["faces_travel"]]
    rows = []
    for panel in panels:
        system, codes = allowed(panel) or ("mutcd", frozenset())
        narrow = sorted(codes - SERIES[US].keys()) or sorted(codes)
        later = (
            (other["station_m"] - panel["station_m"], other["id"])
            for other in panels
            if other["kind"] == panel["kind"]
            and other["assembly_id"] != panel["assembly_id"]
            and (other["lateral_m"] > 0) == (panel["lateral_m"] > 0)
            and other["station_m"] > panel["station_m"]
        )
        rows.append(
            dict.fromkeys(SIGNS.schema.names)
            | {name: panel[name] for name in SAME}
            | {name: 0.0 for name in SIGNS.schema.names if name.startswith("sigma_")}
            | {"sign_id": panel["id"], system: narrow[0] if narrow else None}
            | {"panel_width_m": panel["width_m"], "panel_height_m": panel["height_m"]}
            | dict(
                zip(("spacing_m", "next_sign_id"), min(later, default=(None, None)), strict=True)
            )
            | true_road(truth, panel)
        )
    return rows


def true_road(truth: Row, panel: Row, reach: int = 4) -> dict[str, float | None]:
    """Radius and edge of the road abreast of a panel, by points of its profile 20 m before and behind, as in rows."""
    places = np.array(truth["road"]["profile"])[:, 1:3] @ (1, 1j)
    centre = complex(*panel["centre"][:2])
    at = int(np.argmin(abs(places - centre)))
    if not reach <= at < len(places) - reach:
        return {}
    before, after = places[at] - places[at - reach], places[at + reach] - places[at]
    turn, chord = np.angle(after / before), before + after
    edge = max(line.offset for line in markings(RoadSpec(truth["road"]["kind"])))
    aside = abs(((centre - places[at]) / chord).imag * abs(chord)) - panel["width_m"] / 2 - edge
    return {
        "radius_m": None if abs(turn) < 1e-3 else (abs(before) + abs(after)) / 2 / -turn,
        "offset_edge_m": aside if edge > 1 else None,  # a street has no lines at its edges
        "sigma_offset_edge_m": 0.0,
    }


def true_verdict(check: Check) -> str:
    """The verdict of the rule for the true value."""
    if check.missing:
        return "not checkable"
    return "fails" if check.value < check.least or check.value > check.most else "meets"


def compare(
    out: Path, truth_file: Path
) -> tuple[list[tuple[float, float]], list[tuple[Check, Check | None]]]:
    """Errors of spacings with their sigmas, and each check with that of the truth; None: the rule is not for it."""
    truth = json.loads(truth_file.read_text())
    evaluation = evaluate(out, truth_file)
    assert isinstance(evaluation, RenderedEvaluation)
    panel_of = {match.sign["sign_id"]: match.panel for match in evaluation.found}
    spacings = []
    for row in read_rows(out, SIGNS, ["sign_id", "next_sign_id", "spacing_m", "sigma_spacing_m"]):
        ends = [panel_of.get(row[name]) for name in ("sign_id", "next_sign_id")]
        if None not in ends:
            true = ends[1]["station_m"] - ends[0]["station_m"]  # type: ignore[index]
            spacings.append((row["spacing_m"] - true, row["sigma_spacing_m"]))
    rules = read_rules(["mutcd"])
    of_truth = {
        (check.rule.id, check.sign["sign_id"]): check
        for check in check_rows(true_rows(truth), rules, None)
    }
    pairs = [
        (check, of_truth.get((check.rule.id, panel["id"])))
        for check in check_drive(out, rules)
        if (panel := panel_of.get(check.sign["sign_id"])) is not None
    ]
    return spacings, pairs


def confusion(pairs: Sequence[tuple[Check, Check | None]]) -> Iterator[list[object]]:
    """Rows of the table: a rule and a verdict, with what the truth says."""
    counts = Counter(
        (mine.rule.id, mine.verdict, "not for it" if true is None else true_verdict(true))
        for mine, true in pairs
    )
    for rule in dict.fromkeys(mine.rule.id for mine, _ in pairs):
        for verdict in CHECK_VERDICTS:
            found = [counts[rule, verdict, said] for said in TRUE_VERDICTS]
            if any(found):
                yield [rule, verdict, *found]


TRUE_VERDICTS = ("meets", "fails", "not checkable", "not for it")


def main() -> None:
    """Print the tables."""
    given = [Path(word) for word in sys.argv[1:]]
    spacings: list[tuple[float, float]] = []
    pairs: list[tuple[Check, Check | None]] = []
    for out, truth in zip(given[::2], given[1::2], strict=True):
        some, more = compare(out, truth)
        spacings += some
        pairs += more
    errors = spread(abs(error) for error, _ in spacings)
    share = sigma_share([error for error, _ in spacings], [sigma for _, sigma in spacings])
    print(f"{errors.n} spacings: error median {errors.median} m, 95 % {errors.p95} m; {share}\n")
    print("\n".join(table(("rule", "verdict", *TRUE_VERDICTS), confusion(pairs), words=2)))
    for mine, true in pairs:
        opposite = {"meets": "fails", "fails": "meets"}.get(mine.verdict)
        if true is not None and true_verdict(true) == opposite:
            off = (mine.value - true.value) / mine.sigma
            print(
                f"wrong: {mine.rule.id} {mine.sign['sign_id']}: {mine.said}; true {true.value:.3f}, {off:+.1f} sigma"
            )


if __name__ == "__main__":
    main()
