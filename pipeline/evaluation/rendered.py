"""Compare reported panels with the exact truth of a rendered drive."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from wayside.pipeline.evaluation.figures import (
    Backs,
    Duplicate,
    FalseSign,
    Match,
    MissedPanel,
    RenderedEvaluation,
    Row,
)
from wayside.pipeline.evaluation.misses import Face
from wayside.pipeline.labels.box_matching import overlap
from wayside.stages.geometry import covered_fractions

SMALLEST_HEIGHT_PX, SMALLEST_VISIBLE, FEWEST_FRAMES = 10.0, 0.5, 3
"""A panel that should be found faces the camera, so tall and so visible, in so many images."""
ACROSS_M, ACROSS_SHARE = 1.5, 0.05
ALONG_M, ALONG_SHARE = 3.0, 0.10
"""A panel is matched within the larger of a distance and a fraction of its range."""
SMALLEST_COVER = 0.3
_UNMATCHED = 1e6


def evaluate_against_truth(
    signs: Sequence[Row], truth: Row, backs: Sequence[Row] = ()
) -> RenderedEvaluation:
    """Match panels one to one in the camera frame of `best_frame` and measure the position errors.

    Parameters
    ----------
    signs
        Rows of `signs.parquet` with status `sign`.
    truth
        Content of a `truth.json`.
    backs
        Rows with status `back`.
    """
    panels = [p for p in truth["signs"] if any(view["side"] == "front" for view in p["frames"])]
    eligible = {p["id"] for p in panels if is_eligible(p)}
    errors, pairs = _matched(signs, panels, truth["frames"])
    owner = {j: signs[i]["sign_id"] for i, j in pairs}
    matched = {i for i, _ in pairs}
    hits = [(i, j) for i, j in pairs if panels[j]["id"] in eligible]
    found = {panels[j]["id"] for _, j in hits}
    return RenderedEvaluation(
        wanted=len(eligible),
        matches=tuple(_match(signs[i], panels[j], errors[i, j]) for i, j in hits),
        false=tuple(_false(sign, truth) for i, sign in enumerate(signs) if i not in matched),
        missed=tuple(
            MissedPanel(**{field.name: p.get(field.name) for field in fields(MissedPanel)})
            for p in panels
            if p["id"] in eligible - found
        ),
        backs=_evaluate_backs(backs, truth),
        duplicates=tuple(
            _duplicates((sign for i, sign in enumerate(signs) if i not in matched), panels, owner)
        ),
    )


def missed_faces(evaluation: RenderedEvaluation, truth: Row) -> list[Face]:
    """The missed panels with their views that count: those that make a panel one that should be found."""
    missed = {panel.id for panel in evaluation.missed}
    by_id = {panel["id"]: panel for panel in truth["signs"] if panel["id"] in missed}
    return [
        Face(
            panel.id,
            {view["frame"]: view["box"] for view in by_id[panel.id]["frames"] if _counts(view)},
        )
        for panel in evaluation.missed
    ]


def false_distances(
    evaluation: RenderedEvaluation, signs: Sequence[Row], truth: Row
) -> dict[tuple[str, int | str], float]:
    """Distance of each row that is matched with no panel from each missed panel, metres, by their names.

    Rows whose best frame the truth lacks have none.
    """
    unmatched = {sign.sign_id for sign in evaluation.false}
    rows = [sign for sign in signs if sign["sign_id"] in unmatched]
    missed = {panel.id for panel in evaluation.missed}
    panels = [panel for panel in truth["signs"] if panel["id"] in missed]
    lengths = np.linalg.norm(_matched(rows, panels, truth["frames"])[0], axis=2)
    return {
        (row["sign_id"], panel["id"]): float(lengths[i, j])
        for i, row in enumerate(rows)
        for j, panel in enumerate(panels)
        if np.isfinite(lengths[i, j])
    }


def is_eligible(panel: Row) -> bool:
    """Whether a panel should be found: it faces the camera, tall and visible enough, in enough images."""
    good = sum(_counts(view) for view in panel["frames"])
    return bool(panel["faces_travel"]) and good >= FEWEST_FRAMES


def _counts(view: Row) -> bool:
    """Whether a view shows the front tall and clear enough to be found by."""
    return bool(
        view["side"] == "front"
        and view["box"][3] - view["box"][1] >= SMALLEST_HEIGHT_PX
        and view["visible_fraction"] >= SMALLEST_VISIBLE
    )


def _duplicates(
    unmatched: Iterable[Row], panels: Sequence[Row], owner: Mapping[int, str]
) -> Iterator[Duplicate]:
    """Rows whose best box shows best a front that another row (`owner`, by number of the panel) is matched with.

    The place is not asked: a second row on a face often stands far before or behind it. A front that is mostly hidden
    does not count: the row is on what hides it.
    """
    for sign in unmatched:
        own = np.array([sign["best_box"]])
        shown = [
            (float(overlap(own, view["box"])[0]), j)
            for j, panel in enumerate(panels)
            for view in panel["frames"]
            if view["frame"] == sign["best_frame"]
            and view["side"] == "front"
            and view["visible_fraction"] >= SMALLEST_VISIBLE
        ]
        shared, best = max(shown, default=(0.0, -1))
        if shared > 0 and best in owner:
            yield Duplicate(sign["sign_id"], panels[best]["id"], owner[best])


def _evaluate_backs(rows: Sequence[Row], truth: Row) -> Backs:
    def seen(panel: Row) -> list[Row]:
        return [view for view in panel["frames"] if view["side"] == "back"]

    panels = [panel for panel in truth["signs"] if seen(panel)]
    _, pairs = _matched(rows, panels, truth["frames"])
    tall = [
        sum(view["box"][3] - view["box"][1] >= SMALLEST_HEIGHT_PX for view in seen(panel))
        for panel in panels
    ]
    return Backs(len(rows), len(pairs), sum(count >= FEWEST_FRAMES for count in tall))


def _matched(
    signs: Sequence[Row], panels: Sequence[Row], frames: Sequence[Row]
) -> tuple[NDArray[np.float64], list[tuple[int, int]]]:
    """Reported minus true position, (n, m, 3) metres, and the pairs of row and panel that are matched one to one."""
    poses = {frame["index"]: camera_pose(frame) for frame in frames}
    centres = np.array([panel["centre"] for panel in panels], np.float64).reshape(-1, 3)
    errors = np.full((len(signs), len(panels), 3), np.nan)
    cost = np.full((len(signs), len(panels)), _UNMATCHED)
    for i, sign in enumerate(signs):
        if sign["best_frame"] not in poses:
            continue
        rotation, origin = poses[sign["best_frame"]]
        actual = (centres - origin) @ rotation
        errors[i] = np.array([sign["right_m"], sign["down_m"], sign["ahead_m"]]) - actual
        cost[i] = np.minimum(match_distance(errors[i], actual), _UNMATCHED)
    rows, columns = linear_sum_assignment(cost)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return errors, [(i, j) for i, j in pairs if cost[i, j] < _UNMATCHED]


def match_distance(error: NDArray[np.float64], actual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance (...) of reported from true positions as shares of the tolerances; inf beyond them.

    error, actual (..., 3): reported minus true, and true position in the camera frame, metres.
    """
    reach = np.linalg.norm(actual, axis=-1)
    across = np.hypot(error[..., 0], error[..., 1]) / np.maximum(ACROSS_M, ACROSS_SHARE * reach)
    along = np.abs(error[..., 2]) / np.maximum(ALONG_M, ALONG_SHARE * reach)
    return np.where((across <= 1) & (along <= 1), across + along, np.inf)


def camera_pose(frame: Row) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) from camera to world and camera centre (3,), metres."""
    rotation = Rotation.from_quat(frame["quaternion"]).as_matrix()
    return rotation, np.asarray(frame["position"], np.float64)


def _false(sign: Row, truth: Row) -> FalseSign:
    """A false panel with the known object that covers most of its box in its best image."""
    best, cause = SMALLEST_COVER, "unknown"
    for kind, objects in (("distractor", truth.get("distractors", ())), ("sign", truth["signs"])):
        for entry in objects:
            for view in entry["frames"]:
                if view["frame"] != sign["best_frame"]:
                    continue
                boxes = np.array([sign["best_box"]]), np.array([view["box"]])
                covered = float(covered_fractions(*boxes)[0, 0])
                if covered > best:
                    best, cause = covered, f"{kind} {entry['kind']} {entry['id']}"
    return FalseSign.of(sign, cause, (sign["right_m"], sign["down_m"], sign["ahead_m"]))


def _match(sign: Row, panel: Row, error: NDArray[np.float64]) -> Match:
    right, down, ahead = error.tolist()
    return Match(
        sign["sign_id"],
        panel["id"],
        (right, down, ahead),
        (sign["sigma_lateral_m"], sign["sigma_up_m"], sign["sigma_along_m"]),
        (sign["panel_width_m"], panel["width_m"]),
        (sign["panel_height_m"], panel["height_m"]),
        (sign["bottom_m"], panel["bottom_m"]),
        (sign["color"], panel["color"]),
        (sign["shape"], panel["shape"]),
    )
