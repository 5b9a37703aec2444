"""The tables of real drives: every share with its 95 % interval, drives that a model was learned from apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from common import table
from real_counts import CONFIDENCES, PLATES, Counts, total

from wayside.pipeline.evaluation.figures import KindCount, RealEvaluation, together
from wayside.pipeline.evaluation.misses import STEPS, cause_words, count_steps
from wayside.pipeline.statistics import Interval, rate_interval, share_interval


class RealDrive(NamedTuple):
    """Figures of a real drive.

    unlabelled: rows, right ones, on a sign that its own labels leave out; counts: at each of `CONFIDENCES`, or none.
    """

    name: str
    evaluation: RealEvaluation
    unlabelled: int = 0
    counts: tuple[Counts, ...] = ()


Drives = Sequence[RealDrive]


def real_page(drives: Drives, *, causes: bool = True) -> list[str]:
    """Tables of drives never seen, of drives learned from, of kinds, of what was missed and of the `causes`."""
    lines: list[str] = []
    for title, own in by_source(drives).items():
        parts = share_table(own), kind_table(own), reliability_table(own), confidence_table(own)
        lines += ["", f"### {title}", "", *(line for part in parts for line in part)]
    return [*lines, *step_table(drives), *(cause_table(drives) if causes else [])][1:]


def by_source(drives: Drives) -> dict[str, Drives]:
    """The drives by whether a model of their run was learned from them; groups without a drive are left out."""
    groups: dict[str, list[RealDrive]] = {
        "Never seen by a model of the run": [],
        "Learned from by a model of the run": [],
        "Not known whether learned from": [],
    }
    for drive in drives:
        seen = drive.evaluation.learned_by
        group = "Not known" if seen is None else "Learned from" if seen else "Never seen"
        title = next(title for title in groups if title.startswith(group))
        name = f"{drive.name} ({', '.join(seen)})" if seen else drive.name
        groups[title].append(drive._replace(name=name))
    return {title: own for title, own in groups.items() if own}


def share_table(drives: Drives) -> list[str]:
    """One line a drive, and one for all together."""
    rows = list(drives)
    if len(rows) > 1:
        unlabelled = sum(drive.unlabelled for drive in drives)
        rows.append(RealDrive("**together**", _together(drives), unlabelled))
    head = (
        "drive",
        "images",
        "found of wanted",
        "recall (95 %)",
        "rows on a sign of all",
        "of these without a label",
        "precision, at least (95 %)",
        "on no sign",
        "per 100 images (95 %)",
        "duplicates",
    )
    return table(head, (share_line(drive) for drive in rows))


def share_line(drive: RealDrive) -> list[str]:
    """Cells of one drive."""
    name, e, unlabelled, _ = drive
    rate, rate_ends = e.false_per_100_images, e.false_per_100_images_interval
    return [
        name,
        "-" if e.images is None else str(e.images),
        f"{e.found_count} of {e.wanted}",
        with_interval(e.recall, e.recall_interval, 3),
        f"{e.right} of {e.counted}",
        str(unlabelled),
        with_interval(e.precision, e.precision_interval, 3),
        str(len(e.false)),
        "-" if rate is None else with_interval(rate, rate_ends, 1),
        str(len(e.duplicates)),
    ]


def kind_table(drives: Drives) -> list[str]:
    """Recall of parking and bus stop plates apart from all other signs, where labels mark them."""
    together = _together(drives)
    marked = together.kinds
    plates = [kind for kind in marked if kind.kind in PLATES]
    if not plates:
        return []
    wanted, found = sum(k.wanted for k in plates), sum(k.found for k in plates)
    rows = [
        KindCount("parking and bus stop plates", wanted, found),
        KindCount("all other signs", together.wanted - wanted, together.found_count - found),
    ]
    return [
        "",
        *table(
            ("signs", "found of wanted", "recall (95 %)"),
            (
                [
                    row.kind,
                    f"{row.found} of {row.wanted}",
                    with_interval(
                        row.found / max(1, row.wanted), share_interval(row.found, row.wanted), 3
                    ),
                ]
                for row in rows
            ),
        ),
    ]


def reliability_table(drives: Drives) -> list[str]:
    """Rows by the confidence that they state, and how many of them lie on a sign."""
    bins = _together(drives).reliability
    if not bins:
        return []
    head = ("confidence", "rows", "mean", "on a sign", "share, at least (95 %)")
    rows = [
        [
            one.name,
            str(one.rows),
            f"{one.mean:.3f}",
            str(one.right),
            with_interval(one.right / one.rows, share_interval(one.right, one.rows), 3),
        ]
        for one in bins
    ]
    return ["", *table(head, rows)]


def confidence_table(drives: Drives) -> list[str]:
    """What is found, and what lies on no sign, where rows of other confidences are taken as signs."""
    if not drives or not all(drive.counts for drive in drives):
        return []
    head = (
        "confidence from",
        "plates",
        "all other signs",
        "recall (95 %)",
        "on no sign",
        "per 100 images (95 %)",
    )
    rows = []
    for k, least in enumerate(CONFIDENCES):
        one = total(drive.counts[k] for drive in drives)
        rate = 100 * one.false / one.images
        ends = rate_interval(one.false, one.images / 100)
        rows.append(
            [
                f"{least:g}",
                f"{one.plates} of {one.wanted_plates}",
                f"{one.found} of {one.wanted}",
                with_interval(one.found / one.wanted, share_interval(one.found, one.wanted), 3),
                str(one.false),
                with_interval(rate, ends, 1),
            ]
        )
    return ["", *table(head, rows)]


def step_table(drives: Drives) -> list[str]:
    """How many signs were lost at each step, of each drive that misses any."""
    counts = {d.name: count_steps(d.evaluation.causes) for d in drives if d.evaluation.causes}
    steps = [step for step in STEPS if any(step in count for count in counts.values())]
    if not steps:
        return []
    rows = [
        [name, str(sum(count.values())), *(str(count.get(step, 0)) for step in steps)]
        for name, count in counts.items()
    ]
    return [
        "",
        "### Where the missed signs were lost",
        "",
        *table(("drive", "missed", *(STEPS[step] for step in steps)), rows),
    ]


def cause_table(drives: Drives) -> list[str]:
    """The cause of each miss, one line a sign."""
    rows = [[name, str(c.id), cause_words(c)] for name, e, *_ in drives for c in e.causes]
    if not rows:
        return []
    return ["", "### Cause of each miss", "", *table(("drive", "sign", "cause"), rows, words=3)]


def _together(drives: Drives) -> RealEvaluation:
    return together(drive.evaluation for drive in drives)


def with_interval(value: float, interval: Interval | None, places: int) -> str:
    """A value with both ends of its interval; "-" where nothing was counted."""
    if interval is None:
        return "-"
    return f"{value:.{places}f} ({interval.low:.{places}f} to {interval.high:.{places}f})"
