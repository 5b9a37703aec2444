"""How many codes of signs are right on rendered drives, by the kind that the truth says.

`PYTHONPATH=. python benchmarks/sign_codes.py OUT TRUTH [OUT TRUTH ...]` compares results with their truth files. Right
is a code or a series of the sign. The other panels that were found are wrong or have no code.

`PYTHONPATH=. python benchmarks/sign_codes.py --crops FOLDER` names crops of real tracks that the face classifier has
not learned from. It lists how many are right by the stated probability and by the height of the face.
"""

from __future__ import annotations

import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from common import table

from training.face_classes import TESTED, crops, still_patches
from wayside.pipeline.evaluation.compare import evaluate
from wayside.pipeline.evaluation.figures import RenderedEvaluation
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.results.result import read_rows
from wayside.pipeline.statistics import share_interval
from wayside.schemas.sign_catalogue import SERIES, US, VIENNA
from wayside.schemas.tables import SIGNS
from wayside.stages.sign_codes import FaceClassifier

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
    "eu_no_entry": "C1a C",
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
    """Counts of the matched panels of a drive: right code, right series, undecided, wrong."""
    evaluation = evaluate(out, truth)
    assert isinstance(evaluation, RenderedEvaluation)
    columns = ["sign_id", "mutcd", "vienna", "legend", "code_probability", "nominal_width_in"]
    rows = {row["sign_id"]: row for row in read_rows(out, SIGNS, columns)}
    counts: Counter[str] = Counter()
    for match in evaluation.found:
        row, panel = rows[match.sign["sign_id"]], match.panel
        may_be = allowed(panel)
        if may_be is None:
            counts["kind without a code"] += 1
            continue
        column, codes = may_be
        other = {"mutcd": "vienna", "vienna": "mutcd"}[column]
        stated = row[column]
        if stated is None and row[other] is None:
            counts["undecided"] += 1
        elif stated in codes:
            level = "series" if stated in {*SERIES[US], *SERIES[VIENNA]} else "code"
            counts[f"right {level}"] += 1
        else:
            counts["wrong"] += 1
            print(f"wrong: {row['sign_id']} {stated or row[other]} for {panel['kind']}")
    return counts


def crops_table(real: Path) -> list[str]:
    """Lines of the table of the face classifier that ships, on crops of tracks that were held out."""
    file = load_models(load_settings()[0]).face_network
    assert file is not None
    model = FaceClassifier(file.path)
    examples = list(crops(real, TESTED))
    patches, truth = still_patches(examples)
    log_probabilities = model.log_probabilities(patches)
    right = np.array(model.classes)[log_probabilities.argmax(axis=1)] == truth
    probability = np.exp(log_probabilities.max(axis=1))
    height = np.array([one.box[3] - one.box[1] for one in examples])
    parts = {"all": height > 0}
    parts |= {f"probability at least {p:g}": probability >= p for p in (0.5, 0.7, 0.9)}
    parts["probability below 0.9"] = probability < 0.9
    edges = (0, 24, 32, 48, np.inf)
    parts |= {
        f"{low:g} px high or more, below {high:g}": (height >= low) & (height < high)
        for low, high in pairwise(edges)
    }
    rows = []
    for words, chosen in parts.items():
        count, total = int(right[chosen].sum()), int(chosen.sum())
        low, high = share_interval(count, total) or (0.0, 1.0)
        share = f"{100 * count / max(total, 1):.1f} %"
        rows.append((words, total, share, f"{100 * low:.1f} to {100 * high:.1f} %"))
    return table(("crops", "number", "named right", "95 % interval"), rows)


def main() -> None:
    """Print a table row for each drive and one for all; or the table of the crops."""
    if sys.argv[1] == "--crops":
        print(*crops_table(Path(sys.argv[2])), sep="\n")
        return
    total: Counter[str] = Counter()
    rows = {}
    for out, truth in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        rows[Path(truth).name.split(".")[0]] = counts = compare(Path(out), Path(truth))
        total += counts
    heads = ("right code", "right series", "undecided", "wrong", "kind without a code")
    cells = (
        (name, *(counts[h] for h in heads)) for name, counts in (rows | {"all": total}).items()
    )
    print(*table(("drive", *heads), cells), sep="\n")


if __name__ == "__main__":
    main()
