"""Quote accuracy on drives that no model was learned from and no rule was chosen by.

    .venv/bin/python benchmarks/held_out.py [--jobs 2]

Renders the drives `recordings/drives/specs/held_*.toml` once into .cache/drives, runs both presets on each, and writes
benchmarks/accuracy_held_out.md. Cameras, lights, roads and seeds are other than those for learning and development.
Look at the figures, not at the misses: a drive whose misses are known belongs to the development drives.
"""

from __future__ import annotations

import argparse
import sys

from accept import (
    PRESETS,
    evaluate_drive,
    in_short,
    learned_from,
    rendered,
    rendered_drive,
    rendered_table,
)
from common import BENCHMARKS, render, versions

from wayside.pipeline.evaluation.figures import together

HELD_OUT = {
    "held_border": "",
    "held_bypass": "",
    "held_evening": "",
    "held_hills": "",
    "held_market": "",
    "held_moor": "26.4ft",
    "held_motorway": "",
    "held_outskirts": "",
    "held_quay": "",
    "held_valley": "",
}
"""Held-out drives with the spacing that a run is given, where the log has neither poses nor fixes."""


def main() -> int:
    """Render, run, evaluate, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=2, help="drives rendered at once")
    args = parser.parse_args()
    render(HELD_OUT, args.jobs)
    lines = [
        "# Accuracy on held-out drives",
        "",
        "Made by `python benchmarks/held_out.py`; exact truth. No model was learned from these drives and no rule was "
        "chosen by them: ten cameras (focal lengths, lenses, mounts, 1280 x 720 to 1936 x 1216), ten lights and "
        "roads. Eight were drawn from the ranges that eleven of the learning drives were drawn from, with other "
        "seeds, sizes of image and pairs of road and light. `held_border` and `held_bypass` are of the kind of "
        "eight others, with small hard images, signs far from the road and faces that no catalogue holds. "
        "`held_moor` has neither poses nor fixes, "
        "`held_outskirts` has fixes alone. Columns as in accuracy.md.",
        "",
        versions(),
    ]
    broken = False
    for preset in PRESETS:
        outcomes = [
            evaluate_drive(rendered_drive(name, spacing), preset)
            for name, spacing in HELD_OUT.items()
        ]
        broken |= any(outcome.evaluation is None for outcome in outcomes)
        for line in learned_from({preset: outcomes}):
            print(f"NOT HELD OUT  {line}")
            broken = True
        total = in_short(together(rendered(outcomes)))
        print(f"{preset:8} {'held-out drives together':24} {total}")
        lines += ["", f"## Preset `{preset}`", "", *rendered_table(outcomes)]
    if not broken:
        (BENCHMARKS / "accuracy_held_out.md").write_text("\n".join(lines) + "\n")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
