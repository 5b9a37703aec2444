"""Compare reported panels with the exact truth of a rendered drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wayside.pipeline.evaluation import (
    FalseSign,
    MissedPanel,
    RenderedEvaluation,
    Spread,
    confusion,
    share,
    sigma_share,
    spread,
)

SMALLEST_HEIGHT_PX, SMALLEST_VISIBLE, FEWEST_FRAMES = 10.0, 0.5, 3
"""A panel that should be found faces the camera, so tall and so visible, in so many pictures."""
ACROSS_M, ACROSS_SHARE = 1.5, 0.05
ALONG_M, ALONG_SHARE = 3.0, 0.10
"""A panel is matched within the larger of a distance and a share of its range."""
SMALLEST_COVER = 0.3
_UNMATCHED = 1e6
_AXES = (("lateral", 0), ("up", 1), ("along", 2))

Row = Mapping[str, Any]


def judge_rendered(signs: Sequence[Row], truth: Row) -> RenderedEvaluation:
    """Match panels one to one in the camera frame of `best_frame` and measure the gaps.

    Parameters
    ----------
    signs
        Rows of `signs.parquet` with status `sign`.
    truth
        Content of a `truth.json`.
    """
    panels = [p for p in truth["signs"] if any(view["side"] == "front" for view in p["frames"])]
    eligible = {p["id"] for p in panels if is_eligible(p)}
    gaps, cost = _gaps_and_cost(signs, panels, truth["frames"])
    rows, columns = linear_sum_assignment(cost)
    pairs = [
        (int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i, j] < _UNMATCHED
    ]

    matched = {i for i, _ in pairs}
    hits = [(i, j) for i, j in pairs if panels[j]["id"] in eligible]
    found = [(signs[i], panels[j]) for i, j in hits]
    found_ids = {panel["id"] for _, panel in found}
    errors = np.array([gaps[i, j] for i, j in hits], np.float64).reshape(-1, 3)
    return RenderedEvaluation(
        wanted=len(eligible),
        found=tuple((sign["sign_id"], panel["id"]) for sign, panel in found),
        false=tuple(_false(sign, truth) for i, sign in enumerate(signs) if i not in matched),
        missed=tuple(
            MissedPanel(**{name: p.get(name) for name in MissedPanel.__dataclass_fields__})
            for p in panels
            if p["id"] in eligible and p["id"] not in found_ids
        ),
        error_m={name: spread(np.abs(errors[:, axis])) for name, axis in _AXES}
        | {"total": spread(np.linalg.norm(errors, axis=1))},
        width_error=_size_error(found, "panel_width_m", "width_m", relative=True),
        height_error=_size_error(found, "panel_height_m", "height_m", relative=True),
        bottom_error_m=_size_error(found, "bottom_m", "bottom_m", relative=False),
        sigma_share={
            name: sigma_share(errors[:, axis], [sign.get(f"sigma_{name}_m") for sign, _ in found])
            for name, axis in _AXES
        },
        color_right=share([sign["color"] == panel["color"] for sign, panel in found]),
        shape_right=share([sign["shape"] == panel["shape"] for sign, panel in found]),
        color_confusion=confusion((panel["color"], sign["color"]) for sign, panel in found),
        shape_confusion=confusion((panel["shape"], sign["shape"]) for sign, panel in found),
    )


def is_eligible(panel: Row) -> bool:
    """Whether a panel should be found: it faces the camera, tall and visible enough, in enough pictures."""
    good = sum(
        view["side"] == "front"
        and view["box"][3] - view["box"][1] >= SMALLEST_HEIGHT_PX
        and view["visible_fraction"] >= SMALLEST_VISIBLE
        for view in panel["frames"]
    )
    return bool(panel["faces_travel"]) and good >= FEWEST_FRAMES


def cover(inner: Sequence[float], outer: Sequence[float]) -> float:
    """Share of box `inner` that lies in box `outer`."""
    width = min(inner[2], outer[2]) - max(inner[0], outer[0])
    height = min(inner[3], outer[3]) - max(inner[1], outer[1])
    area = (inner[2] - inner[0]) * (inner[3] - inner[1])
    return width * height / area if width > 0 and height > 0 and area > 0 else 0.0


def _gaps_and_cost(
    signs: Sequence[Row], panels: Sequence[Row], frames: Sequence[Row]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Reported minus true position, (n, m, 3) metres, and cost of each match, (n, m), 1e6 where out of reach."""
    poses = {frame["index"]: _pose(frame) for frame in frames}
    centres = np.array([panel["centre"] for panel in panels], np.float64).reshape(-1, 3)
    gaps = np.zeros((len(signs), len(panels), 3))
    cost = np.full((len(signs), len(panels)), _UNMATCHED)
    for i, sign in enumerate(signs):
        if sign["best_frame"] not in poses:
            continue
        rotation, origin = poses[sign["best_frame"]]
        actual = (centres - origin) @ rotation
        gaps[i] = np.array([sign["right_m"], sign["down_m"], sign["ahead_m"]]) - actual
        reach = np.linalg.norm(actual, axis=1)
        across = np.hypot(gaps[i, :, 0], gaps[i, :, 1]) / np.maximum(ACROSS_M, ACROSS_SHARE * reach)
        along = np.abs(gaps[i, :, 2]) / np.maximum(ALONG_M, ALONG_SHARE * reach)
        near = (across <= 1) & (along <= 1)
        cost[i, near] = (across + along)[near]
    return gaps, cost


def _pose(frame: Row) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) from camera to world and camera centre (3,), metres."""
    x, y, z, w = frame["quaternion"]
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation, np.asarray(frame["position"], np.float64)


def _false(sign: Row, truth: Row) -> FalseSign:
    """A false panel with the known thing that covers most of its box in its best picture."""
    best, cause = SMALLEST_COVER, "unknown"
    for kind, things in (("distractor", truth.get("distractors", ())), ("sign", truth["signs"])):
        for thing in things:
            for view in thing["frames"]:
                if view["frame"] != sign["best_frame"]:
                    continue
                covered = cover(sign["best_box"], view["box"])
                if covered > best:
                    best, cause = covered, f"{kind} {thing['kind']} {thing['id']}"
    return FalseSign(
        sign["sign_id"],
        sign["best_frame"],
        tuple(sign["best_box"]),
        sign["color"],
        sign["shape"],
        (sign["right_m"], sign["down_m"], sign["ahead_m"]),
        cause,
    )


def _size_error(
    found: Sequence[tuple[Row, Row]], ours: str, theirs: str, *, relative: bool
) -> Spread:
    """Absolute or relative error of a measured length; signs without it are left out."""
    known = [(sign.get(ours), panel[theirs]) for sign, panel in found]
    return spread(abs(a - b) / (b if relative else 1.0) for a, b in known if a is not None)
