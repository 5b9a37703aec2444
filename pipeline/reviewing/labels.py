"""Labels that a review gives: every view of a reviewed row."""

from __future__ import annotations

from pathlib import Path

from wayside.pipeline.results.result import read_rows
from wayside.pipeline.reviewing.review import EDITED, REJECTED, Review
from wayside.schemas.labels import BACK, NOT_A_SIGN, SIGN, Label, LabelledImage, Labels
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS


def review_labels(out: Path, review: Review) -> Labels:
    """A label of each measured view of each reviewed row; a missing sign has no box and is left out, counted.

    Raises InputError if the folder is no result folder, or damaged.
    """
    names = ["sign_id", "log", "status", "color", "shape"]
    signs = {row["sign_id"]: row for row in read_rows(out, SIGNS, names)}
    frames = read_rows(out, FRAMES, ["frame", "log_time_ns"])
    times_ns = {row["frame"]: row["log_time_ns"] for row in frames}
    labels = []
    for row in read_rows(out, OBSERVATIONS, ["sign_id", "frame", "box"], {"verdict": "sign"}):
        said = review.rows.get(row["sign_id"])
        if said is None:
            continue
        sign = signs[row["sign_id"]]
        look = said if said.review == EDITED else None
        kind = BACK if sign["status"] == "back" else SIGN
        rejected = said.review == REJECTED
        labels.append(
            Label(
                LabelledImage(sign["log"], row["frame"], times_ns[row["frame"]]),
                NOT_A_SIGN if rejected else kind,
                tuple(row["box"]),
                None if rejected else look.color if look else sign["color"],
                None if rejected else look.shape if look else sign["shape"],
                panel=row["sign_id"],
                source=said.reviewer or "review",
                note=said.note,
            )
        )
    left_out = {"missing_without_box": len(review.missing)} if review.missing else {}
    return Labels(tuple(labels), (), left_out)
