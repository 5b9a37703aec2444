"""Compare reported panels with the exact truth of a rendered drive."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from wayside.pipeline.evaluation.figures import (
    FALSE_COLUMNS,
    Backs,
    Duplicate,
    Match,
    RenderedEvaluation,
    Row,
)
from wayside.pipeline.evaluation.misses import Face
from wayside.pipeline.labels.box_matching import overlap
from wayside.stages.geometry import covered_fractions

SMALLEST_HEIGHT_PX, SMALLEST_VISIBLE, FEWEST_FRAMES = 10.0, 0.5, 3
"""Least height, visibility and number of images of a panel that should be found; it faces the camera."""
ACROSS_M, ACROSS_SHARE = 1.5, 0.05
ALONG_M, ALONG_SHARE = 3.0, 0.10
"""A panel is matched within the larger of a distance and a fraction of its range."""
SMALLEST_COVER = 0.3
PLACE_COLUMNS = ("right_m", "down_m", "ahead_m")
MISSED_KEYS = ("id", "kind", "color", "shape", "width_m", "height_m", "lateral_m", "station_m")
_UNMATCHED = 1e6


def evaluate_against_truth(
    signs: Sequence[Row], truth: Row, backs: Sequence[Row] = ()
) -> RenderedEvaluation:
    """Match panels one to one in the camera frame of `best_frame` and measure the position errors.

    `signs`, `backs`: rows of `signs.parquet` with these statuses. `truth`: content of a `truth.json`.
    """
    panels = [p for p in truth["signs"] if any(view["side"] == "front" for view in p["frames"])]
    eligible = {p["id"]: p for p in panels if is_eligible(p)}
    errors, pairs = _matched(signs, panels, truth["frames"])
    matched = dict(pairs)
    found = tuple(
        Match(signs[i], panels[j], tuple(errors[i, j].tolist()))
        for i, j in pairs
        if panels[j]["id"] in eligible
    )
    missed = eligible.keys() - {match.panel["id"] for match in found}
    unmatched = [sign for i, sign in enumerate(signs) if i not in matched]
    owner = {j: signs[i]["sign_id"] for i, j in pairs}
    return RenderedEvaluation(
        wanted=len(eligible),
        found=found,
        right=len(found),
        false=tuple(
            {name: sign[name] for name in (*FALSE_COLUMNS, *PLACE_COLUMNS)}
            | {"cause": _known_thing(sign, truth)}
            for sign in unmatched
        ),
        missed=tuple(
            {name: panel.get(name) for name in MISSED_KEYS}
            for name, panel in eligible.items()
            if name in missed
        ),
        duplicates=tuple(_duplicates(unmatched, panels, owner)),
        backs=_evaluate_backs(backs, truth),
    )


def missed_faces(evaluation: RenderedEvaluation, signs: Sequence[Row], truth: Row) -> list[Face]:
    """The missed panels with their views that count, and how far from them the rows stand that match no panel."""
    unmatched = {sign["sign_id"] for sign in evaluation.false}
    rows = [sign for sign in signs if sign["sign_id"] in unmatched]
    missed = {panel["id"] for panel in evaluation.missed}
    panels = [panel for panel in truth["signs"] if panel["id"] in missed]
    gaps = np.linalg.norm(_matched(rows, panels, truth["frames"])[0], axis=2)
    return [
        Face(
            panel["id"],
            {view["frame"]: view["box"] for view in panel["frames"] if _counts(view)},
            {row["sign_id"]: float(gaps[i, j]) for i, row in enumerate(rows) if gaps[i, j] >= 0},
        )
        for j, panel in enumerate(panels)
    ]


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
        errors[i] = np.array([sign[name] for name in PLACE_COLUMNS]) - actual
        cost[i] = np.minimum(match_distance(errors[i], actual), _UNMATCHED)
    rows, columns = linear_sum_assignment(cost)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return errors, [(i, j) for i, j in pairs if cost[i, j] < _UNMATCHED]


def match_distance(error: NDArray[np.float64], actual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance (...) of reported from true positions as shares of the tolerances; inf beyond them.

    `error`, `actual` (..., 3): reported minus true, and true position in the camera frame, metres.
    """
    reach = np.linalg.norm(actual, axis=-1)
    across = np.hypot(error[..., 0], error[..., 1]) / np.maximum(ACROSS_M, ACROSS_SHARE * reach)
    along = np.abs(error[..., 2]) / np.maximum(ALONG_M, ALONG_SHARE * reach)
    return np.where((across <= 1) & (along <= 1), across + along, np.inf)


def camera_pose(frame: Row) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) from camera to world and camera centre (3,), metres."""
    rotation = Rotation.from_quat(frame["quaternion"]).as_matrix()
    return rotation, np.asarray(frame["position"], np.float64)


def _known_thing(sign: Row, truth: Row) -> str:
    """The known object that covers most of the box of a row in its best image."""
    best, cause = SMALLEST_COVER, "unknown"
    own = np.array([sign["best_box"]])
    for kind, objects in (("distractor", truth.get("distractors", ())), ("sign", truth["signs"])):
        for thing in objects:
            for view in thing["frames"]:
                if view["frame"] != sign["best_frame"]:
                    continue
                covered = float(covered_fractions(own, np.array([view["box"]]))[0, 0])
                if covered > best:
                    best, cause = covered, f"{kind} {thing['kind']} {thing['id']}"
    return cause
