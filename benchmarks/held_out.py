"""Quote accuracy on drives that no model was learned from.

    .venv/bin/python benchmarks/held_out.py [--jobs 2]

Renders the drives `recordings/drives/specs/held_*.toml` once into .cache/drives, runs both presets on each, and writes
benchmarks/accuracy_held_out.md. Cameras, lights, roads and seeds are other than those for learning and development.
Look at the figures, not at the misses: a drive whose misses are known belongs to the development drives.
"""

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter

from accept import (
    PRESETS,
    evaluate_drive,
    in_short,
    rendered,
    rendered_drive,
    rendered_table,
    unfit,
    write_page,
)
from common import render

from wayside.pipeline.evaluation.figures import together

NAMES = "border bypass evening hills market moor motorway outskirts quay valley".split()
HELD_OUT = {f"held_{name}": "26.4ft" if name == "moor" else "" for name in NAMES}
"""Held-out drives with the spacing that a run is given, where the log has neither poses nor fixes."""


def main() -> int:
    """Render, run, evaluate, write."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="drives rendered at once")
    args = parser.parse_args()
    render(HELD_OUT, args.jobs)
    parts, broken = {}, False
    for preset in PRESETS:
        outcomes = [
            evaluate_drive(rendered_drive(name, spacing), preset)
            for name, spacing in HELD_OUT.items()
        ]
        for line in unfit({preset: outcomes}):
            print(f"NOT HELD OUT  {line}")
            broken = True
        total = in_short(together(rendered(outcomes)))
        print(f"{preset:8} {'held-out drives together':24} {total}")
        parts[f"Preset `{preset}`"] = rendered_table(outcomes)
    if not broken:
        write_page("accuracy_held_out.md", parts)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
