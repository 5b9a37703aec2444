"""Measures the merging of drives on simulated roads: duplicates, position error, changes found.

    python benchmarks/merging.py passes changes --seeds 27 28 29

Prints the tables of merging.md: sums over the seeds with 95 % intervals, means with the lowest and the highest.
"""

import tempfile
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from common import print_table
from merging_simulation import (
    DAY_NS,
    START_NS,
    YEAR_NS,
    Quality,
    change_road,
    make_road,
    write_drive,
)

from wayside.pipeline.fleet.changes import find_changes, parse_survey
from wayside.pipeline.fleet.merging import merge_inventory
from wayside.pipeline.statistics import rate_interval, share_interval

Identities = dict[str, list[int]]
"""True panel of each row of a drive, by the drive's name; -1: none."""
ROADS, LENGTH_M, SPACING_M = 3, 10_000.0, 32.0
PASSES = (1, 2, 4, 8)
CHANGED = 0.17
STATED = (0.0, 0.1, 0.5, 0.8, 1.01)


def sighted(inventory: Path, identities: Identities) -> Iterator[tuple[dict[str, Any], int]]:
    """Rows of `sightings/` with the true panel of each."""
    for row in ds.dataset(inventory / "sightings").to_table().to_pylist():
        yield row, identities[row["drive"]][int(row["sign_id"].rsplit("-", 1)[1]) - 1]


@dataclass(frozen=True, slots=True)
class Identified:
    """Which true panels the rows of an inventory hold.

    The true panel `of` a `panel_id` has the most of its sightings. There are `seen` true panels, and `duplicates` rows
    too many for them. Rows of several true panels are `mixed`, and those of a true panel with a sighting of none are
    `spurious`.
    """

    of: dict[str, int]
    seen: int
    duplicates: int
    mixed: int
    spurious: int


def panel_identities(inventory: Path, identities: Identities) -> Identified:
    """The true panels of the rows of an inventory."""
    of_panel: defaultdict[str, Counter[int]] = defaultdict(Counter)
    for row, identity in sighted(inventory, identities):
        of_panel[row["panel_id"]][identity] += 1
    true = [[one for one in counts if one >= 0] for counts in of_panel.values()]
    rows_of = Counter(one for some in true for one in some)
    return Identified(
        {n: c.most_common(1)[0][0] for n, c in of_panel.items()},
        len(rows_of),
        sum(count - 1 for count in rows_of.values()),
        sum(len(some) > 1 for some in true),
        sum(-1 in counts and len(counts) > 1 for counts in of_panel.values()),
    )


@dataclass(frozen=True, slots=True)
class Passed:
    """One inventory of some passes: what its rows are of, and root mean squares of their errors, metres."""

    rows: Identified
    level_m: float
    stated_m: float
    height_m: float


def measure_passes(seeds: Sequence[int]) -> None:
    """Duplicates and position error against the number of passes."""
    runs = [_passes(seed) for seed in seeds]
    counted = ("duplicates per 1,000", "rows of two panels", "with a spurious sighting")
    heads = ("passes", "panels", *counted, "level error, RMS", "1/sqrt(n)", "stated", "height")
    alone = float(np.mean([run[0].level_m for run in runs]))
    rows = []
    for k, passes in enumerate(PASSES):
        of = [run[k] for run in runs]
        seen, mixed, spurious, twice = (
            sum(getattr(one.rows, name) for one in of)
            for name in ("seen", "mixed", "spurious", "duplicates")
        )
        between = rate_interval(twice, seen / 1000)
        assert between is not None  # panels were seen
        often = f"{1000 * twice / seen:.1f} ({between.low:.1f} to {between.high:.1f})"
        level, stated, height = (
            _ranged([getattr(one, name) for one in of])
            for name in ("level_m", "stated_m", "height_m")
        )
        bound = f"{alone / passes**0.5:.2f} m"
        rows.append((passes, seen, often, mixed, spurious, level, bound, stated, height))
    print_table(heads, rows, words=0)


def _ranged(values: Sequence[float]) -> str:
    words = f"{np.mean(values):.2f} m"
    return words + (f" ({min(values):.2f} to {max(values):.2f})" if len(values) > 1 else "")


def _passes(seed: int) -> list[Passed]:
    """Inventories of so many of the `PASSES` over the same roads."""
    rng = np.random.default_rng(seed)
    roads = [make_road(k, LENGTH_M, SPACING_M, rng) for k in range(ROADS)]
    truth = {int(i): (road, k) for road in roads for k, i in enumerate(road.identity)}
    found = []
    with tempfile.TemporaryDirectory() as scratch:
        root, identities = Path(scratch), {}
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
            rows = panel_identities(root / "inventory", identities)
            errors = []
            for row in ds.dataset(root / "inventory" / "panels").to_table().to_pylist():
                if rows.of[row["panel_id"]] in truth:
                    road, at = truth[rows.of[row["panel_id"]]]
                    place = np.array([[row["lon_deg"], row["lat_deg"], row["alt_m"]]])
                    away = road.origin.topocentric(place)[0] - road.position[at]
                    errors.append([*away, row["sigma_east_m"], row["sigma_north_m"]])
            square = np.square(errors).mean(axis=0)
            level, stated, height = np.sqrt([square[:2].sum(), square[3:].sum(), square[2]])
            found.append(Passed(rows, float(level), float(stated), float(height)))
    return found


@dataclass(slots=True)
class Told:
    """A comparison against the true history: rows, rows of places not in view, per kind all and those found right.

    `stated`: of each row that is gone or new its probability, and whether it is right.
    """

    rows: int = 0
    unknown: int = 0
    total: Counter[str] = field(default_factory=Counter)
    right: Counter[str] = field(default_factory=Counter)
    false: int = 0
    stated: list[tuple[float, bool]] = field(default_factory=list)


def measure_changes(seeds: Sequence[int]) -> None:
    """What is found of changes between two surveys."""
    kinds = ("unchanged", "gone", "moved", "changed_face", "new")
    names = ("unchanged re-found", "gone", "moved", "changed face", "new")
    stated: list[tuple[float, bool]] = []
    rows = []
    for drives in (1, 2, 3):
        told = Told(stated=stated)
        for seed in seeds:
            _changes(seed, drives, told)
        words = [_share(told.right[kind], told.total[kind], 1) for kind in kinds]
        rows.append((drives, f"{told.unknown} of {told.rows}", *words, told.false))
    print_table(("drives a survey", "not in view", *names, "false changes"), rows, words=0)
    rows = []
    for low, high in pairwise(STATED):
        some = [one for one in stated if low <= one[0] < high]
        mean = 100 * np.mean([probability for probability, _ in some])
        right = _share(sum(right for _, right in some), len(some), 0)
        rows.append((f"{low:.1f} to {min(high, 1):.1f}", len(some), f"{mean:.0f} %", right))
    print()
    print_table(("stated", "gone or new", "mean", "right"), rows, words=0)


def _share(right: int, total: int, places: int) -> str:
    between = share_interval(right, total)
    assert between is not None  # there are such rows
    share, low, high = (f"{100 * one:.{places}f}" for one in (right / total, *between))
    return f"{right} of {total} ({share} %; {low} to {high})"


def _changes(seed: int, drives: int, told: Told) -> None:
    """Compare two surveys of the roads of one seed."""
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
                    drive = write_drive(root / "drives" / name, one, start, True, Quality(), rng)
                    identities[name] = drive.tolist()
        merge_inventory(sorted((root / "drives").iterdir()), root)
        find_changes(root, parse_survey("2024"), parse_survey("2025"))
        _count_changes(told, root, identities, history)


def _count_changes(
    counted: Told, root: Path, identities: Identities, history: dict[int, tuple[str, int | None]]
) -> None:
    of = panel_identities(root, identities).of
    told: dict[int, str] = {}
    blank: set[int] = set()  # a face that one survey saw only from behind has no known change
    rows = pq.read_table(root / "changes.parquet").to_pylist()
    for row in rows:
        before, after = (of.get(row[f"panel_{side}"], -1) for side in ("before", "after"))
        identity = before if before >= 0 else after
        told.setdefault(identity, row["change"])
        if None in (row["color_before"], row["color_after"]) and row["change"] == "unchanged":
            blank.add(identity)
    became = {after: kind for kind, after in history.values() if after is not None}
    for row in rows:
        if row["probability"] is not None:
            before, after = (of.get(row[f"panel_{side}"], -1) for side in ("before", "after"))
            kind = became.get(after) if before < 0 else history.get(before, ("unchanged", None))[0]
            counted.stated.append((row["probability"], kind not in (None, "unchanged")))
    counted.rows += len(rows)
    counted.unknown += sum(row["change"] == "not_looked_at" for row in rows)
    for identity, (kind, _) in history.items():
        found = told.get(identity)
        if found is None or found == "not_looked_at":  # not seen, or said not to be known
            continue
        if kind == "changed_face" and identity in blank:
            continue
        counted.total[kind] += 1
        counted.right[kind] += found == kind
        counted.false += kind == "unchanged" and found != kind


MEASURED = {"passes": measure_passes, "changes": measure_changes}


def main() -> None:
    """Print the tables that were chosen."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="+", choices=MEASURED)
    parser.add_argument("--seeds", type=int, nargs="+", default=[27])
    given = parser.parse_args()
    for what in given.what:
        MEASURED[what](given.seeds)


if __name__ == "__main__":
    main()
