"""Chapters 5 to 8: the track of a sign, calibration, residuals of the motion, the scene in three dimensions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.calibration.boards import calibrate_images, parse_board
from wayside.pipeline.calibration.coverage import draw_coverage
from wayside.pipeline.learning.samples import NEITHER, OFF, ON
from wayside.pipeline.report_figures.drawing import SIGN_INK, around, beside, boxed, cut
from wayside.pipeline.report_figures.gather import Drive
from wayside.pipeline.report_figures.numbers import share_words
from wayside.pipeline.report_figures.page import Figure, photo
from wayside.pipeline.report_figures.plots import INKS, Plot
from wayside.schemas.detections import COLOR_RGB
from wayside.schemas.landmarks import Landmark
from wayside.stages.report import mean_log_density

FEET = 0.3048
_JUDGED = {ON: "yes", OFF: "no", NEITHER: "not known"}
REPORT_SIZE_FT = (3.5, 2.0)
SCENE_M = 25.0
"""Points of the scene are drawn so near to the camera, and so far beside its path."""


def track_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 5.2 to 5.4."""
    title, report = (
        "the track of a sign through four images",
        "SIFT points are followed from image to image",
    )
    labelled = [one for one in drive.signs if drive.judge(one) == ON]
    longest = max(labelled or drive.signs, key=lambda one: len(one.views), default=None)
    if longest is None:
        yield Figure("5.2", title, report, needs="a sign that is followed over several images")
    else:
        yield _track(drive, longest, title, report)
    yield _trajectories(drive)


def board_figure(boards: list[Path], board: str | None) -> Figure:
    """Figure 6.1, by images of a chessboard where some are given."""
    title = "calibration by a chessboard"
    report = "a chessboard on a foam sheet of 4 x 8 ft; no residual is given"
    if not boards or board is None:
        return Figure(
            "6.1", title, report, needs="images of a chessboard: --boards FOLDER --board 9x6"
        )
    found = calibrate_images(boards, parse_board(board, float("nan")), "plumb_bob")
    one = found.calibration
    drawn = draw_coverage(found)
    used = sum(view.used for view in one.views)
    return Figure(
        "6.1",
        title,
        report,
        f"{used} of {len(found.images)} images used, {one.rms_px:.2f} px RMS, fx {one.camera.fx:.1f} px, "
        f"fy {one.camera.fy:.1f} px, centre {one.camera.cx:.1f}, {one.camera.cy:.1f} px",
        (
            photo(
                np.asarray(cv2.cvtColor(drawn, cv2.COLOR_BGR2RGB), np.uint8),
                "corners of all images",
                scale=0.7,
            ),
        ),
    )


def _trajectories(drive: Drive) -> Figure:
    """Figures 5.3 and 5.4: one image with all tracks on it, and with those that move as signs do."""
    title = "segments before and after the trajectory classifier"
    report = 'typically all false segments are removed, except on curves: "typically all" colour false positives'
    asked = [one for one in drive.landmarks if one.verdict in ("sign", "location", "duplicate")]
    if not asked:
        return Figure("5.3, 5.4", title, report, needs="tracks of candidates that pass the colours")
    typical = [
        mean_log_density(one.trajectory, drive.density) >= drive.density.threshold for one in asked
    ]
    words = []
    for what, label in (("tracks on signs kept", ON), ("others removed", OFF)):
        own = [
            keeps == (label == ON)
            for one, keeps in zip(asked, typical, strict=True)
            if drive.judge(one) == label
        ]
        words.append(f"{what} {share_words(sum(own), len(own))}")
    counts = Counter(view.frame for one in asked for view in one.views)
    frame = max(counts, key=lambda k: (counts[k], -k))
    rgb = drive.images({frame})[frame]
    pages = []
    for shown in ([True] * len(asked), typical):
        boxes = [
            view.box
            for one, is_shown in zip(asked, shown, strict=True)
            for view in one.views
            if is_shown and view.frame == frame
        ]
        pages.append(photo(boxed(rgb, boxes, SIGN_INK), f"image {frame}: {len(boxes)} segments"))
    return Figure("5.3, 5.4", title, report, "; ".join(words), tuple(pages))


def residual_figure(drive: Drive) -> Figure:
    """Figure 7.2: eq. 7.5 by straight motion and by the adjusted one, image by image."""
    steps = sorted(drive.frames.items())
    straight = np.array([(k, m.residual_straight_px) for k, m in steps])
    adjusted = np.array([(k, m.residual_px) for k, m in steps])
    turns = np.array([0.0 if m.step is None else _turn_deg(m.step.rotation) for _, m in steps])
    good = np.isfinite(straight[:, 1])
    title = "residual of straight motion"
    report = (
        "low on straight road, high in curves, where two views are adjusted; no number is given"
    )
    if not good.any():
        return Figure("7.2", title, report, needs="two images that follow each other")
    top = float(np.nanmax(np.concatenate([straight[:, 1], adjusted[:, 1]])))
    plot = Plot(
        (float(straight[0, 0]), float(straight[-1, 0])),
        (0, 1.1 * top),
        ("image", "residual per coordinate, px"),
    )
    plot.line(straight, INKS[1], "straight motion")
    plot.line(adjusted, INKS[2], "motion that is used")
    bent = good & (np.abs(turns) > 0.5)
    even = good & ~bent
    words = [
        f"{np.median(straight[rows, 1]):.2f} px in {rows.sum()} steps that turn by {kind} than half a degree"
        for rows, kind in ((even, "less"), (bent, "more"))
        if rows.any()
    ]
    median = float(np.nanmedian(adjusted[good, 1]))
    return Figure(
        "7.2",
        title,
        report,
        f"median of straight motion {', '.join(words)}; of the motion that is used {median:.2f} px",
        (plot.picture(),),
    )


def scene_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 8.3 to 8.6."""
    signs = drive.signs
    title = "the scene from above and across the road"
    report = (
        "stripes lie between the yellow signs at the left and the green and white ones at the right"
    )
    if not signs or not drive.frames:
        yield Figure("8.3 to 8.5", title, report, needs="signs in three dimensions")
        yield Figure(
            "8.6",
            "size of a sign",
            "about 3.5 ft wide, 2 ft high",
            needs="signs in three dimensions",
        )
        return
    yield _scene(drive, signs, title, report)
    yield _size(drive, signs)


def _track(drive: Drive, sign: Landmark, title: str, report: str) -> Figure:
    views = sorted(sign.views, key=lambda view: view.frame)
    at = np.unique(np.linspace(0, len(views) - 1, 4).round().astype(int))
    images = drive.images({views[i].frame for i in at})
    crops = []
    for i in at:
        rgb = images[views[i].frame]
        corners = around(views[i].box, rgb.shape[:2], times=6, least=160)
        crops.append(cut(boxed(rgb, [views[i].box], SIGN_INK), corners, 230))
    page = images[views[-1].frame].copy()
    path = np.array([(view.u_px, view.v_px) for view in views])
    cv2.polylines(page, [np.rint(path).astype(np.int32)[:, None]], False, SIGN_INK, 3, cv2.LINE_AA)
    for u, v in path:
        cv2.circle(page, (round(u), round(v)), 7, SIGN_INK, -1, cv2.LINE_AA)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    lengths = ", ".join(f"{length:.0f}" for length in steps)
    return Figure(
        "5.2",
        title,
        report,
        f"{len(views)} images, frames {views[0].frame} to {views[-1].frame}; "
        f"it moves by {lengths} px from image to image",
        (photo(beside(crops)), photo(page, "its path in the last image", scale=0.5)),
    )


def _named(sign: Landmark) -> str:
    words = " ".join(word for word in (sign.color, sign.shape) if word)
    return words.replace("_", " ") or "sign"


def _turn_deg(rotation: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arctan2(rotation[0, 2], rotation[2, 2])))


def _scene(drive: Drive, signs: list[Landmark], title: str, report: str) -> Figure:
    places = np.array([one.best_pose.to_world(one.position) for one in signs])
    path = np.array([m.pose.centre for _, m in sorted(drive.frames.items())])
    far = max(float(path[:, 2].max()), float(places[:, 2].max()))
    above = Plot(
        (float(min(path[:, 2].min(), 0)), far + 5),
        (-SCENE_M, SCENE_M),
        ("ahead of the first camera, m", "left of its axis, m"),
        (1080, 420),
        equal=True,
    )
    points = [
        m.pose.to_world(m.ties.point[m.ties.inlier & (np.abs(m.ties.point) < SCENE_M).all(axis=1)])
        for _, m in sorted(drive.frames.items())
        if m.ties is not None
    ]
    ground = np.concatenate(points) if points else np.zeros((0, 3))
    above.points(
        ground[:: max(len(ground) // 3000, 1)][:, [2, 0]] * (1, -1), "#b8c0c8", "tie points", 1.0
    )
    above.line(path[:, [2, 0]] * (1, -1), "#161b22", "camera")
    across = Plot(
        (-15, 15), (-3, 8), ("right of the path, m", "above the camera, m"), (640, 300), equal=True
    )
    for one, place in zip(signs, places, strict=True):
        ink = "#{:02x}{:02x}{:02x}".format(*COLOR_RGB.get(one.color or "", (150, 150, 150)))
        above.points([(place[2], -place[0])], ink, radius=5)
        if drive.judge(one) == ON:
            above.word((place[2], -place[0]), _named(one))
        across.points([(one.right_m, one.above_m)], ink, radius=5)
    mean = np.array([3.121, 0.603])
    across.points([mean], "#161b22", "report's mean sign", radius=4)
    right = [one.right_m for one in signs]
    return Figure(
        "8.3 to 8.5",
        title,
        report,
        f"{len(signs)} signs, {sum(r < 0 for r in right)} left and {sum(r >= 0 for r in right)} right of the path, at "
        f"{np.median(np.abs(right)):.1f} m from it (median); "
        "the report's mean sign is 3.1 m right, 0.6 m above the camera",
        (above.picture("from above; named: on labelled signs"), across.picture("across the road")),
    )


def _size(drive: Drive, signs: list[Landmark]) -> Figure:
    listed = [sign for sign in signs if drive.judge(sign) == ON] or signs
    # that of the report is one whose size the adjustment gave well
    one = min(listed, key=lambda sign: sign.sigma_width_m / sign.width_m)
    wide, tall = one.width_m / FEET, one.height_m / FEET
    plot = Plot((-0.5, wide + 1), (-0.5, tall + 1), ("ft", "ft"), (420, 320), equal=True)
    corners = np.array([(0, 0), (wide, 0), (wide, tall), (0, tall), (0, 0)])
    plot.line(corners, INKS[0], "the sign", width=2.5)
    plot.line(
        np.array([(0, 0), (3.5, 0), (3.5, 2), (0, 2), (0, 0)]),
        INKS[1],
        "the report's sign",
        dashed=True,
    )
    sizes = [
        ("sign", "on a labelled sign", "width ft", "height ft", "width m", "height m"),
        *(
            (
                f"{_named(s)}, frame {s.best_frame}",
                _JUDGED[drive.judge(s)],
                f"{s.width_m / FEET:.1f} ± {s.sigma_width_m / FEET:.1f}",
                f"{s.height_m / FEET:.1f} ± {s.sigma_height_m / FEET:.1f}",
                f"{s.width_m:.2f}",
                f"{s.height_m:.2f}",
            )
            for s in listed
        ),
    ]
    others = len(signs) - len(listed)
    return Figure(
        "8.6",
        "size of a sign on a grid of feet",
        f"about {REPORT_SIZE_FT[0]} ft wide and {REPORT_SIZE_FT[1]:.0f} ft high, read from points of the adjustment",
        f"the sign of the surest width, {_named(one)}: {wide:.1f} ± {one.sigma_width_m / FEET:.1f} ft wide, "
        f"{tall:.1f} ± {one.sigma_height_m / FEET:.1f} ft high, by its boxes in {len(one.views)} images; "
        f"{others} rows that are on no labelled sign are not listed",
        (plot.picture(),),
        table=tuple(sizes),
    )
