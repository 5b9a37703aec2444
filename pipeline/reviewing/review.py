"""The review of a result: where it lies, its labels and its figures."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wayside.pipeline.results.result import read_rows, read_times
from wayside.pipeline.reviewing.entries import ACCEPTED, EDITED, REJECTED, read_entries
from wayside.pipeline.reviewing.known import KnownResult
from wayside.pipeline.reviewing.matching import NO_REVIEW, Review, settled
from wayside.pipeline.statistics import Interval, share_interval
from wayside.schemas.errors import UsageError
from wayside.schemas.labels import BACK, NOT_A_SIGN, SIGN, Label, LabelledImage, Labels
from wayside.schemas.tables import OBSERVATIONS, SIGNS

FILES = ("review*.json", "review*.csv")
"""Reviews that lie in the folder of their result."""


def find_review(out: Path, given: Sequence[Path] = (), known: KnownResult | None = None) -> Review:
    """The review of a result by the files given, else by all that lie in its folder, as one.

    `known`: the rows of the result, where they are read already. Raises InputError if a file is no review, or is of
    another drive.
    """
    files = given or [path for name in FILES for path in sorted(out.glob(name))]
    if not files:
        return NO_REVIEW
    return settled([read_entries(file) for file in files], known or KnownResult.of(out))


def required_review(out: Path, given: Sequence[Path] = ()) -> Review:
    """The review of a result as `find_review` finds it; raises UsageError without one."""
    review = find_review(out, given)
    if review == NO_REVIEW:
        raise UsageError(
            f"{out}: there are no corrections to make labels from: no review.json or review.csv. Save them in its "
            "evidence index, or name the file with --review of `wayside label`."
        )
    return review


def review_labels(out: Path, review: Review) -> Labels:
    """A label of each measured view of each reviewed row; a missing sign has no box and is left out, counted.

    Raises InputError if the folder is no result folder, or damaged.
    """
    signs = {row["sign_id"]: row for row in read_rows(out, SIGNS, ["sign_id", "log", "status"])}
    times_ns = read_times(out)
    labels = []
    for row in read_rows(out, OBSERVATIONS, ["sign_id", "frame", "box"], {"verdict": "sign"}):
        said = review.rows.get(row["sign_id"])
        if said is None:
            continue
        sign, look = signs[row["sign_id"]], said.final({})
        kind = BACK if sign["status"] == "back" else SIGN
        labels.append(
            Label(
                LabelledImage(sign["log"], row["frame"], times_ns[row["frame"]]),
                NOT_A_SIGN if said.review == REJECTED else kind,
                tuple(row["box"]),
                look["color"],
                look["shape"],
                panel=row["sign_id"],
                source=said.reviewer or "review",
                note=said.note,
            )
        )
    left_out = {"missing_without_box": len(review.missing), "undecided": len(review.undecided)}
    return Labels(tuple(labels), (), {reason: count for reason, count in left_out.items() if count})


def review_figures(out: Path, review: Review) -> dict[str, Any]:
    """Counts of the rows with status `sign` by their review, and shares with their 95 % intervals, as JSON has them.

    `color_stated`, `shape_stated`: right rows that state one; `color_right`, `shape_right`: of these, those whose is
    right. `others`: reviewed rows of another status, which count for nothing. Raises InputError as `review_labels`.
    """
    columns = ["sign_id", "color", "shape"]
    rows = {row["sign_id"]: row for row in read_rows(out, SIGNS, columns, {"status": "sign"})}
    said = {name: review.rows[name] for name in rows if name in review.rows}
    counts = Counter(one.review for one in said.values())
    figures: dict[str, Any] = {"rows": len(rows), "missing": len(review.missing)}
    figures |= {"others": len(review.rows) - len(said), "reviewed": len(said)}
    figures |= {name: counts[name] for name in (ACCEPTED, EDITED, REJECTED)}
    for look in ("color", "shape"):
        right = [
            one.final(rows[name])[look] == rows[name][look]
            for name, one in said.items()
            if one.review in (ACCEPTED, EDITED) and rows[name][look] is not None
        ]
        figures |= {f"{look}_stated": len(right), f"{look}_right": sum(right)}
    signs = counts[ACCEPTED] + counts[EDITED]
    for name, total in (("precision", len(said)), ("recall", signs + len(review.missing))):
        figures |= {name: signs / total if total else None, f"{name}_of": total}
        figures[f"{name}_interval"] = share_interval(signs, total)
    return figures


def format_figures(figures: dict[str, Any]) -> str:
    """All figures as plain text."""
    f, signs = figures, figures[ACCEPTED] + figures[EDITED]
    precision, recall = (
        _shown(signs, f[f"{name}_of"], f[f"{name}_interval"]) for name in ("precision", "recall")
    )
    lines = [
        f"reviewed   {f['reviewed']} of {f['rows']} rows with status sign: {f[ACCEPTED]} accepted, {f[EDITED]} edited, "
        f"{f[REJECTED]} rejected",
        f"precision  {precision} of the reviewed rows are signs",
        f"recall     {recall} of the signs known to the reviewer; {f['missing']} missing",
        f"colour     {_shown(f['color_right'], f['color_stated'])} right",
        f"shape      {_shown(f['shape_right'], f['shape_stated'])} right",
    ]
    if f["others"]:
        lines.append(f"not counted: {f['others']} reviewed rows with status back or uncertain")
    if f["reviewed"] < f["rows"]:
        left = f["rows"] - f["reviewed"]
        lines.append(f"{left} rows are not reviewed: recall counts none of them")
    return "\n".join(lines)


def _shown(count: int, total: int, interval: Interval | None = None) -> str:
    share = "-" if total == 0 else f"{count / total:.3f}"
    between = "" if interval is None else f" ({interval[0]:.3f} to {interval[1]:.3f})"
    return f"{share}   {count} of {total}{between}"
