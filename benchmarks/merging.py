"""Measures the merging of drives on simulated roads: duplicates, position error, changes found, time and memory.

    python benchmarks/merging.py passes changes
    python benchmarks/merging.py scale --panels 20000

Prints the tables of merging.md. `scale` merges in a process of its own, whose peak memory is taken.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from merging_simulation import (
    DAY_NS,
    START_NS,
    YEAR_NS,
    Quality,
    change_road,
    make_road,
    write_drive,
)

from wayside.pipeline.fleet.changes import find_changes
from wayside.pipeline.fleet.merging import merge_inventory
from wayside.pipeline.fleet.surveys import parse_survey

Identities = dict[str, list[int]]
"""True panel of each row of a drive, by the drive's name; -1: none."""
ROADS, LENGTH_M, SPACING_M = 3, 10_000.0, 32.0
PASSES = (1, 2, 4, 8)
CHANGED = 0.17


def sighted(inventory: Path, identities: Identities) -> Iterator[tuple[dict[str, Any], int]]:
    """Rows of `sightings/` with the true panel of each."""
    for row in ds.dataset(inventory / "sightings").to_table().to_pylist():
        yield row, identities[row["drive"]][int(row["sign_id"].rsplit("-", 1)[1]) - 1]


def panel_identities(
    inventory: Path, identities: Identities
) -> tuple[dict[str, int], int, int, int]:
    """True panel by `panel_id`; true panels that were seen, rows too many for them, rows of more than one."""
    of_panel: defaultdict[str, Counter[int]] = defaultdict(Counter)
    for row, identity in sighted(inventory, identities):
        of_panel[row["panel_id"]][identity] += 1
    rows_of = Counter(one for counts in of_panel.values() for one in counts if one >= 0)
    mixed = sum(len([one for one in counts if one >= 0]) > 1 for counts in of_panel.values())
    duplicates = sum(count - 1 for count in rows_of.values())
    return {n: c.most_common(1)[0][0] for n, c in of_panel.items()}, len(rows_of), duplicates, mixed


def measure_passes(seed: int) -> None:
    """Duplicates and position error against the number of passes."""
    rng = np.random.default_rng(seed)
    roads = [make_road(k, LENGTH_M, SPACING_M, rng) for k in range(ROADS)]
    truth = {int(i): (road, k) for road in roads for k, i in enumerate(road.identity)}
    print(
        "| passes | panels | duplicates per 1,000 | rows of two panels | level error, RMS | 1/sqrt(n) | stated "
        "| height |"
    )
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as scratch:
        root, identities, alone = Path(scratch), {}, 0.0
        for k in range(max(PASSES)):
            for n, road in enumerate(roads):
                name = f"pass{k}_road{n}"
                drive = write_drive(
                    root / "drives" / name, road, START_NS + k * DAY_NS, k % 4 != 3, Quality(), rng
                )
                identities[name] = drive.tolist()
        for passes in PASSES:
            chosen = [p for p in sorted((root / "drives").iterdir()) if int(p.name[4]) < passes]
            merge_inventory(chosen, root / "inventory")
            of, seen, duplicates, mixed = panel_identities(root / "inventory", identities)
            errors = []
            for row in ds.dataset(root / "inventory" / "panels").to_table().to_pylist():
                if of[row["panel_id"]] in truth:
                    road, at = truth[of[row["panel_id"]]]
                    place = np.array([[row["lon_deg"], row["lat_deg"], row["alt_m"]]])
                    away = road.origin.topocentric(place)[0] - road.position[at]
                    errors.append([*away, row["sigma_east_m"], row["sigma_north_m"]])
            square = np.square(errors)
            level = float(np.sqrt(square[:, :2].sum(axis=1).mean()))
            stated = float(np.sqrt(square[:, 3:].sum(axis=1).mean()))
            alone = alone or level
            print(
                f"| {passes} | {seen} | {1000 * duplicates / seen:.1f} | {mixed} | {level:.2f} m "
                f"| {alone / passes**0.5:.2f} m | {stated:.2f} m | {float(np.sqrt(square[:, 2].mean())):.2f} m |",
                flush=True,
            )


def measure_changes(seed: int) -> None:
    """What is found of changes between two surveys."""
    print(
        "| drives a survey | not looked at | unchanged re-found | gone | moved | changed face | new | false changes |"
    )
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for drives in (1, 2, 3):
        rng = np.random.default_rng(seed)
        with tempfile.TemporaryDirectory() as scratch:
            root, identities, history = Path(scratch), {}, {}
            for n in range(ROADS):
                road = make_road(n, LENGTH_M, SPACING_M, rng)
                later, changes = change_road(road, CHANGED, rng)
                history |= changes
                for year, one in enumerate((road, later)):
                    for k in range(drives):
                        name = f"year{year}_pass{k}_road{n}"
                        start = START_NS + year * YEAR_NS + k * DAY_NS
                        drive = write_drive(
                            root / "drives" / name, one, start, True, Quality(), rng
                        )
                        identities[name] = drive.tolist()
            merge_inventory(sorted((root / "drives").iterdir()), root)
            find_changes(root, parse_survey("2024"), parse_survey("2025"))
            _print_changes(drives, root, identities, history)


def _print_changes(
    drives: int, root: Path, identities: Identities, history: dict[int, tuple[str, int | None]]
) -> None:
    of = panel_identities(root, identities)[0]
    told: dict[int, str] = {}
    blank: set[int] = (
        set()
    )  # a face that one survey saw from behind only cannot be told from another
    rows = pq.read_table(root / "changes.parquet").to_pylist()
    for row in rows:
        before, after = (of.get(row[f"panel_{side}"], -1) for side in ("before", "after"))
        identity = before if before >= 0 else after
        told.setdefault(identity, row["change"])
        if None in (row["color_before"], row["color_after"]) and row["change"] == "unchanged":
            blank.add(identity)
    right: Counter[str] = Counter()
    total: Counter[str] = Counter()
    false = 0
    for identity, (kind, _) in history.items():
        found = told.get(identity)
        if found is None or found == "not_looked_at":  # not seen, or said not to be known
            continue
        if kind == "changed_face" and identity in blank:
            continue
        total[kind] += 1
        right[kind] += found == kind
        false += kind == "unchanged" and found != kind
    unknown = sum(row["change"] == "not_looked_at" for row in rows)
    words = [
        f"{right[k]} of {total[k]} ({100 * right[k] / max(total[k], 1):.1f} %)"
        for k in ("unchanged", "gone", "moved", "changed_face", "new")
    ]
    print(
        f"| {drives} | {unknown} of {len(rows)} | " + " | ".join(words) + f" | {false} |",
        flush=True,
    )


def measure_scale(panels: int, seed: int) -> None:
    """Time and peak memory of merging so many panels, each passed five times."""
    rng = np.random.default_rng(seed)
    count = max(1, round(panels / (LENGTH_M / SPACING_M * 1.4)))
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        for n in range(count):
            road = make_road(n, LENGTH_M, SPACING_M, rng)
            for k in range(5):
                write_drive(
                    root / "drives" / f"road{n:05d}_pass{k}",
                    road,
                    START_NS + k * DAY_NS,
                    k != 3,
                    Quality(),
                    rng,
                )
        command = [sys.executable, __file__, "merge", "--folder", str(root)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    figures = json.loads(done.stdout.splitlines()[-1])
    print("| panels | sightings | drives | processor time | a sighting | peak memory |")
    print("| ---: | ---: | ---: | ---: | ---: | ---: |")
    print(
        f"| {figures['panels']} | {figures['sightings']} | {figures['drives']} | {figures['cpu_s']:.0f} s "
        f"| {1e3 * figures['cpu_s'] / figures['sightings']:.2f} ms | {figures['peak_mb']:.0f} MB |"
    )


def merge(folder: Path) -> None:
    """Merge the drives of a folder and print the figures as JSON."""
    drives = sorted((folder / "drives").iterdir())
    merge_inventory(drives[:5], folder / "warm")  # compiles
    start = time.process_time()
    report = merge_inventory(drives, folder / "inventory")
    figures = {
        "panels": report.panels,
        "sightings": report.sightings,
        "drives": report.drives,
        "cpu_s": time.process_time() - start,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    print(json.dumps(figures))


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="+", choices=("passes", "changes", "scale", "merge"))
    parser.add_argument("--seed", type=int, default=27)
    parser.add_argument("--panels", type=int, default=20_000)
    parser.add_argument("--folder", type=Path, help="of `merge`: holds drives/")
    given = parser.parse_args()
    if "passes" in given.what:
        measure_passes(given.seed)
    if "changes" in given.what:
        measure_changes(given.seed)
    if "scale" in given.what:
        measure_scale(given.panels, given.seed)
    if "merge" in given.what:
        merge(given.folder)


if __name__ == "__main__":
    main()
