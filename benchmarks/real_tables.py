"""The tables of real drives: every share with its 95 % interval, drives that a model was learned from apart."""

from __future__ import annotations

from collections.abc import Sequence

from reached import table

from wayside.pipeline.evaluate_misses import STEPS, cause_words, count_steps
from wayside.pipeline.evaluation import (
    RealEvaluation,
    together_real,
)
from wayside.pipeline.evaluation_findings import (
    KindCount,
)
from wayside.pipeline.statistics import Interval, share_interval

PLATES = ("parking plate", "bus stop plate")
"""Kinds of the labels that stand for parking and bus stop plates: small, and hung in touching pairs and fours."""

Drives = Sequence[tuple[str, RealEvaluation]]


def real_page(drives: Drives) -> list[str]:
    """Tables of drives never seen, of drives that a model was learned from, of kinds, and of what was missed."""
    lines: list[str] = []
    for title, own in by_source(drives).items():
        parts = share_table(own), kind_table(own), reliability_table(own)
        lines += ["", f"### {title}", "", *(line for part in parts for line in part)]
    return [*lines, *step_table(drives), *cause_table(drives)]


def by_source(drives: Drives) -> dict[str, Drives]:
    """The drives by whether a model of their run was learned from them; groups without a drive are left out."""
    groups: dict[str, list[tuple[str, RealEvaluation]]] = {
        "Never seen by a model of the run": [],
        "Learned from by a model of the run": [],
        "Not known whether learned from": [],
    }
    for name, e in drives:
        seen = e.learned_by
        group = "Not known" if seen is None else "Learned from" if seen else "Never seen"
        title = next(title for title in groups if title.startswith(group))
        groups[title].append((f"{name} ({', '.join(seen)})" if seen else name, e))
    return {title: own for title, own in groups.items() if own}


def share_table(drives: Drives) -> list[str]:
    """One line a drive, and one for all together."""
    rows = list(drives)
    if len(rows) > 1:
        rows.append(("**together**", together_real(e for _, e in drives)))
    head = (
        "drive",
        "images",
        "found of wanted",
        "recall (95 %)",
        "rows on a label of all",
        "precision, at least (95 %)",
        "on no label",
        "per 100 images (95 %)",
        "duplicates",
    )
    return table(head, (share_line(name, e) for name, e in rows))


def share_line(name: str, e: RealEvaluation) -> list[str]:
    """Cells of one drive."""
    rate, rate_ends = e.false_per_100_images, e.false_per_100_images_interval
    return [
        name,
        "-" if e.images is None else str(e.images),
        f"{e.found_count} of {e.wanted}",
        with_interval(e.recall, e.recall_interval, 3),
        f"{e.right} of {e.counted}",
        with_interval(e.precision, e.precision_interval, 3),
        str(len(e.false)),
        "-" if rate is None else with_interval(rate, rate_ends, 1),
        str(len(e.duplicates)),
    ]


def kind_table(drives: Drives) -> list[str]:
    """Recall of parking and bus stop plates apart from all other signs, where labels mark them."""
    marked = together_real(e for _, e in drives).kinds
    plates = [kind for kind in marked if kind.kind in PLATES]
    if not plates:
        return []
    total = together_real(e for _, e in drives)
    wanted, found = sum(k.wanted for k in plates), sum(k.found for k in plates)
    rows = [
        KindCount("parking and bus stop plates", wanted, found),
        KindCount("all other signs", total.wanted - wanted, total.found_count - found),
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
    """Rows by the confidence that they state, and how many of them lie on a label."""
    bins = together_real(e for _, e in drives).reliability
    if not bins:
        return []
    head = ("confidence", "rows", "mean", "on a label", "share, at least (95 %)")
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


def step_table(drives: Drives) -> list[str]:
    """How many signs of each drive were lost at each step."""
    counts = {name: count_steps(e.causes) for name, e in drives}
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
    rows = [[name, str(c.id), cause_words(c)] for name, e in drives for c in e.causes]
    if not rows:
        return []
    return ["", "### Cause of each miss", "", *table(("drive", "sign", "cause"), rows, "---")]


def with_interval(value: float, interval: Interval | None, places: int) -> str:
    """A value with both ends of its interval; "-" where nothing was counted."""
    if interval is None:
        return "-"
    return f"{value:.{places}f} ({interval.low:.{places}f} to {interval.high:.{places}f})"
