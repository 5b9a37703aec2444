"""The tables of real drives: every share with its 95 % interval, drives that a model was learned from apart."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from common import table

from wayside.pipeline.evaluation.figures import RealEvaluation, together
from wayside.pipeline.evaluation.misses import STEPS, cause_words, count_steps
from wayside.pipeline.evaluation.real import evaluate_against_labels
from wayside.pipeline.results.result import read_rows
from wayside.pipeline.statistics import Interval, rate_interval, share_interval
from wayside.schemas.tables import OBSERVATIONS, SIGNS

PLATES = ("parking plate", "bus stop plate")
"""Kinds of the labels that stand for parking and bus stop plates: small, and hung in touching pairs and fours."""
CONFIDENCES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Confidences whose counts are listed; a run reports signs from 0.5 on."""
SHARE_HEADS = (
    "drive|images|found of wanted|recall (95 %)|rows on a sign of all|of these without a label"
    "|precision, at least (95 %)|on no sign|per 100 images (95 %)|duplicates"
).split("|")
CONFIDENCE_HEADS = (
    "confidence from|plates|all other signs|recall (95 %)|on no sign|per 100 images (95 %)"
).split("|")


class Counts(NamedTuple):
    """Signs found of those wanted, without plates and plates alone, rows on no sign, and images."""

    found: int
    wanted: int
    plates: int
    wanted_plates: int
    false: int
    images: int


class RealDrive(NamedTuple):
    """Figures of a real drive.

    `unlabelled`: right rows on a sign that its own labels leave out. `counts`: at each of `CONFIDENCES`, or none.
    """

    name: str
    evaluation: RealEvaluation
    unlabelled: int = 0
    counts: tuple[Counts, ...] = ()


Drives = Sequence[RealDrive]


def counts_by_confidence(
    out: Path, labels: Mapping[str, Any], confidences: Sequence[float] = CONFIDENCES
) -> tuple[Counts, ...]:
    """Counts of a result against labels, rows of at least each confidence taken as signs; none where none is stated."""
    columns = ("sign_id", "status", "confidence", "best_frame", "best_box", "color", "shape")
    rows = [row for row in read_rows(out, SIGNS, columns) if row["status"] != "back"]
    if any(row["confidence"] is None for row in rows):
        return ()
    seen = read_rows(out, OBSERVATIONS, ("sign_id", "frame", "box"))
    counts = []
    for least in confidences:
        signs = [row for row in rows if row["confidence"] >= least]
        e = evaluate_against_labels(signs, seen, labels)
        split = split_kinds([e])
        counts.append(Counts(*split, len(e.false), len(labels["frames"])))
    return tuple(counts)


def split_kinds(evaluations: Iterable[RealEvaluation]) -> tuple[int, int, int, int]:
    """Signs found and wanted of all kinds but plates, then of plates."""
    e = together(evaluations)
    plates = [one for one in e.kinds if one.kind in PLATES]
    found, wanted = sum(one.found for one in plates), sum(one.wanted for one in plates)
    return e.found_count - found, e.wanted - wanted, found, wanted


def real_page(drives: Drives, *, causes: bool = True) -> list[str]:
    """Tables of drives never seen, of drives learned from, of kinds, of what was missed and of the `causes`."""
    lines: list[str] = []
    for title, own in by_source(drives).items():
        parts = share_table(own), kind_table(own), reliability_table(own), confidence_table(own)
        lines += ["", f"### {title}", "", *(line for part in parts for line in part)]
    return [*lines, *step_table(drives), *(cause_table(drives) if causes else [])][1:]


def by_source(drives: Drives) -> dict[str, Drives]:
    """The drives by whether a model of their run was learned from them; groups without a drive are left out."""
    never, learned = "Never seen by a model of the run", "Learned from by a model of the run"
    unknown = "Not known whether learned from"
    groups: dict[str, list[RealDrive]] = {never: [], learned: [], unknown: []}
    for drive in drives:
        seen = drive.evaluation.learned_by
        name = f"{drive.name} ({', '.join(seen)})" if seen else drive.name
        title = unknown if seen is None else learned if seen else never
        groups[title].append(drive._replace(name=name))
    return {title: own for title, own in groups.items() if own}


def share_table(drives: Drives) -> list[str]:
    """One line a drive, and one for all together."""
    rows = list(drives)
    if len(rows) > 1:
        unlabelled = sum(drive.unlabelled for drive in drives)
        rows.append(RealDrive("**together**", _together(drives), unlabelled))
    return table(SHARE_HEADS, map(share_line, rows))


def share_line(drive: RealDrive) -> list[str]:
    """Cells of one drive."""
    name, e, unlabelled, _ = drive
    right, precision = share(e.right, e.counted)
    return [
        *(name, "-" if e.images is None else str(e.images)),
        *share(e.found_count, e.wanted),
        *(right, str(unlabelled), precision),
        *rate(len(e.false), e.images or 0),
        str(len(e.duplicates)),
    ]


def kind_table(drives: Drives) -> list[str]:
    """Recall of parking and bus stop plates apart from all other signs, where labels mark them."""
    found, wanted, plates, wanted_plates = split_kinds(drive.evaluation for drive in drives)
    if not wanted_plates:
        return []
    rows = [
        ["parking and bus stop plates", *share(plates, wanted_plates)],
        ["all other signs", *share(found, wanted)],
    ]
    return ["", *table(("signs", "found of wanted", "recall (95 %)"), rows)]


def reliability_table(drives: Drives) -> list[str]:
    """Rows by the confidence that they state, and how many of them lie on a sign."""
    rows = [
        [one.name, one.rows, f"{one.mean:.3f}", one.right, share(one.right, one.rows)[1]]
        for one in _together(drives).reliability
    ]
    head = ("confidence", "rows", "mean", "on a sign", "share, at least (95 %)")
    return ["", *table(head, rows)] if rows else []


def confidence_table(drives: Drives) -> list[str]:
    """What is found, and what lies on no sign, where rows of other confidences are taken as signs."""
    if not drives or not all(drive.counts for drive in drives):
        return []
    rows = []
    for least, *counts in zip(CONFIDENCES, *(drive.counts for drive in drives), strict=True):
        one = Counts(*map(sum, zip(*counts, strict=True)))
        plates = f"{one.plates} of {one.wanted_plates}"
        found, false = share(one.found, one.wanted), rate(one.false, one.images)
        rows.append([f"{least:g}", plates, *found, *false])
    return ["", *table(CONFIDENCE_HEADS, rows)]


def step_table(drives: Drives) -> list[str]:
    """How many signs were lost at each step, of each drive that misses any."""
    counts = {d.name: count_steps(d.evaluation.causes) for d in drives if d.evaluation.causes}
    steps = [step for step in STEPS if any(step in count for count in counts.values())]
    rows = [
        [name, sum(count.values()), *(count.get(step, 0) for step in steps)]
        for name, count in counts.items()
    ]
    lines = table(("drive", "missed", *(STEPS[step] for step in steps)), rows)
    return ["", "### Where the missed signs were lost", "", *lines] if rows else []


def cause_table(drives: Drives) -> list[str]:
    """The cause of each miss, one line a sign."""
    rows = [[name, c.id, cause_words(c)] for name, e, *_ in drives for c in e.causes]
    lines = table(("drive", "sign", "cause"), rows, words=3)
    return ["", "### Cause of each miss", "", *lines] if rows else []


def _together(drives: Drives) -> RealEvaluation:
    return together(drive.evaluation for drive in drives)


def share(count: int, total: int) -> list[str]:
    """Cells: a count of its total, and the fraction with its interval."""
    ends = share_interval(count, total)
    return [f"{count} of {total}", with_interval(count / max(1, total), ends, 3)]


def rate(count: int, images: int) -> list[str]:
    """Cells: a count, and how many there are in 100 images with the interval."""
    ends = rate_interval(count, images / 100)
    return [str(count), with_interval(100 * count / max(1, images), ends, 1)]


def with_interval(value: float, interval: Interval | None, places: int) -> str:
    """A value with both ends of its interval; "-" where nothing was counted."""
    if interval is None:
        return "-"
    return f"{value:.{places}f} ({interval.low:.{places}f} to {interval.high:.{places}f})"
