"""How many codes of signs are right on rendered drives, by the kind that the truth says.

`PYTHONPATH=. python benchmarks/sign_codes.py OUT TRUTH [OUT TRUTH ...]` compares results with their truth files. Right
is a code or a series of the sign. The other panels that were found are wrong or have no code.

`PYTHONPATH=. python benchmarks/sign_codes.py --crops FOLDER` names crops of real tracks that the face classifier has
not learned from. It lists how many are right by the stated probability and by the height of the face.
"""

import sys
import tomllib
from collections import Counter
from collections.abc import Mapping
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

CODES: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
"""Codes and series that a kind of sign may be stated as, by system; those of warning diamonds by legend, too."""


def allowed(panel: Mapping[str, Any]) -> tuple[str, frozenset[str]] | None:
    """The system of a true panel and all that it may be stated as; None where no code is known for its kind."""
    kind = panel["kind"]
    system = next((one for one in ("vienna", "mutcd") if kind in CODES[one]), None)
    if system is None:
        return None
    codes = set(CODES[system][kind].split())
    if kind.startswith("warning"):
        codes.add(CODES["warnings"].get(panel["legend"], "W"))
    if kind.startswith(("guide", "city", "street", "mile", "service", "recreation")):
        codes.add("D/E/I")
    return system, frozenset(codes)


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
