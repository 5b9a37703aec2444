"""How many codes of signs are right on rendered drives, by the kind that the truth says.

`python benchmarks/sign_codes.py OUT TRUTH [OUT TRUTH ...]` compares results of `wayside run` with their truth files.
Right is a code, or a series, that the sign is of; the rest of the panels that were found are wrong or not settled.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from wayside.pipeline.evaluate import evaluate
from wayside.pipeline.evaluation import RenderedEvaluation
from wayside.pipeline.result import read_rows
from wayside.schemas.sign_catalogue import SERIES, US, VIENNA
from wayside.schemas.tables import SIGNS

US_CODES = {
    "stop": "R1-1 R",
    "yield": "R1-2 R",
    "speed_limit": "R2-1 R",
    "regulatory_text": "R",
    "keep_right": "R4-7 R",
    "no_parking": "R7-1 R",
    "do_not_enter": "R5-1 R",
    "wrong_way": "R5-1a R",
    "crossbuck": "R15-1 R",
    "tracks_plaque": "R15-2P R",
    "warning_diamond": "W",
    "advisory_speed": "W13-1P W",
    "chevron": "W1-8 W",
    "large_arrow": "W1-6 W",
    "no_passing_zone": "W14-3 W",
    "rail_advance": "W10-1 W",
    "pedestrian_diamond": "W11-2 W",
    "school": "S1-1 S",
    "school_plaque": "S",
    "work_diamond": "TTC",
    "work_panel": "TTC",
    "object_marker": "OM3 OM",
    "guide_distances": "D",
    "guide_destination": "D1 D",
    "guide_large": "E",
    "guide_overhead": "E",
    "street_name": "D3-1 D",
    "city_limit": "",
    "mile_post": "D10 D",
    "service": "D9 D",
    "service_large": "D",
    "recreation": "D",
    "us_route": "M1-4 M",
    "interstate": "M1-1 M",
    "state_route": "M1-5 M",
    "county_route": "M1-6 M",
    "route_plaque": "M3 M",
    "route_arrow": "M6 M",
}
"""Codes and series that a US kind of sign may be stated as; all guide signs also as their group."""

VIENNA_CODES = {
    "eu_speed_limit": "C14 C",
    "eu_no_overtaking": "C13a C",
    "eu_no_entry": "C1 C",
    "eu_warning": "A",
    "eu_give_way": "B1 B",
    "eu_priority": "B3 B",
    "eu_mandatory": "D1 D",
    "eu_crossing": "E12 E",
    "eu_parking": "E14 E",
    "eu_town": "E",
    "eu_town_end": "E",
    "eu_beacon": "A29 A",
    "eu_board": "G",
}
WARNINGS = {
    "stop_ahead": "W3-1",
    "signal": "W3-3",
    "crossroad": "W2-1",
    "side_road": "W2-2",
    "curve_right": "W1-2",
    "curve_left": "W1-2",
    "turn_right": "W1-1",
    "winding": "W1-5",
    "pedestrian": "W11-2",
    "NO OUTLET": "W14-2",
}
"""Codes of diamonds by their legend."""


def allowed(panel: dict[str, Any]) -> tuple[str, frozenset[str]] | None:
    """The system of a true panel and all that it may be stated as; None where no code is known for its kind."""
    kind, legend = panel["kind"], panel["legend"]
    if kind in VIENNA_CODES:
        return "vienna", frozenset(VIENNA_CODES[kind].split())
    if kind not in US_CODES:
        return None
    codes = {*US_CODES[kind].split(), WARNINGS.get(legend, "W")} - (
        set() if kind.startswith("warning") else {"W"} - set(US_CODES[kind].split())
    )
    if kind.startswith(("guide", "city", "street", "mile", "service", "recreation")):
        codes.add("D/E/I")
    return "mutcd", frozenset(codes)


def compare(out: Path, truth: Path) -> Counter[str]:
    """Counts of the matched panels of a drive: right code, right series, not settled, wrong."""
    evaluation = evaluate(out, truth)
    assert isinstance(evaluation, RenderedEvaluation)
    columns = ["sign_id", "mutcd", "vienna", "legend", "code_probability", "nominal_width_in"]
    rows = {row["sign_id"]: row for row in read_rows(out, SIGNS, columns)}
    panels = {p["id"]: p for p in json.loads(truth.read_text("utf-8"))["signs"]}
    counts: Counter[str] = Counter()
    for match in evaluation.matches:
        row, panel = rows[match.sign_id], panels[match.panel_id]
        may_be = allowed(panel)
        if may_be is None:
            counts["kind without a code"] += 1
            continue
        column, codes = may_be
        other = {"mutcd": "vienna", "vienna": "mutcd"}[column]
        stated = row[column]
        if stated is None and row[other] is None:
            counts["not settled"] += 1
        elif stated in codes:
            level = "series" if stated in {*SERIES[US], *SERIES[VIENNA]} else "code"
            counts[f"right {level}"] += 1
        else:
            counts["wrong"] += 1
            print(f"wrong: {match.sign_id} {stated or row[other]} for {panel['kind']}")
    return counts


def main() -> None:
    """Print a table row for each drive and one for all."""
    total: Counter[str] = Counter()
    heads = ("right code", "right series", "not settled", "wrong", "kind without a code")
    print("| drive |", " | ".join(heads), "|")
    for out, truth in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        counts = compare(Path(out), Path(truth))
        total += counts
        print(
            f"| {Path(truth).name.split('.')[0]} |", " | ".join(str(counts[h]) for h in heads), "|"
        )
    print("| all |", " | ".join(str(total[h]) for h in heads), "|")


if __name__ == "__main__":
    main()
