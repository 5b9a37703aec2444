"""Chapters 5 to 8 and 11: tracks, calibration, residuals of the motion, the scene, and what is found."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from wayside.pipeline.calibration.boards import calibrate_images, draw_coverage, parse_board
from wayside.pipeline.evaluation.rendered import FEWEST_FRAMES
from wayside.pipeline.labels.box_matching import Box, same_thing
from wayside.pipeline.learning.gates import KANSAS_MEAN
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON
from wayside.pipeline.learning.page import FAINT, INKS, TEXT, Figure, new_axes, svg
from wayside.pipeline.report_figures.drive import (
    ACCENT,
    SIGN_INK,
    Drive,
    around,
    beside,
    boxed,
    cut,
    evenly,
    figure,
    photo,
)
from wayside.pipeline.statistics import rate_words, share_words
from wayside.schemas.detections import COLOR_RGB
from wayside.schemas.labels import SIGN
from wayside.schemas.landmarks import Landmark
from wayside.stages.report import mean_log_ratio

FEET = 0.3048
_JUDGED = {ON: "yes", OFF: "no", NEITHER: "not known"}
REPORT_SIZE_FT = (3.5, 2.0)
SCENE_M = 25.0
"""Points of the scene are drawn so near to the camera, and so far beside its path."""


def track_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 5.2 to 5.4."""
    labelled = [one for one in drive.signs if drive.judge(one) == ON]
    longest = max(labelled or drive.signs, key=lambda one: len(one.views), default=None)
    if longest is None:
        yield figure("5.2").left_out("a sign that is followed over several images")
    else:
        yield _track(drive, longest)
    yield _trajectories(drive)


def board_figure(boards: list[Path], board: str | None) -> Figure:
    """Figure 6.1, by images of a chessboard where some are given."""
    if not boards or board is None:
        return figure("6.1").left_out("images of a chessboard: --boards FOLDER --board 9x6")
    found = calibrate_images(boards, parse_board(board, float("nan")), "plumb_bob")
    one = found.calibration
    drawn = np.asarray(cv2.cvtColor(draw_coverage(found), cv2.COLOR_BGR2RGB), np.uint8)
    return figure("6.1").shown(
        f"{sum(view.used for view in one.views)} of {len(found.images)} images used, {one.rms_px:.2f} px RMS, fx "
        f"{one.camera.fx:.1f} px, fy {one.camera.fy:.1f} px, centre {one.camera.cx:.1f}, {one.camera.cy:.1f} px",
        photo(drawn, "corners of all images", scale=0.7),
    )


def _trajectories(drive: Drive) -> Figure:
    """Figures 5.3 and 5.4: one image with all tracks on it, and with those that move as signs do."""
    asked = [one for one in drive.landmarks if one.verdict in ("sign", "location", "duplicate")]
    if not asked:
        return figure("5.3, 5.4").left_out("tracks of candidates that pass the colours")
    density = drive.density
    typical = [mean_log_ratio(one.trajectory, density) >= density.threshold for one in asked]
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
    for shown in (asked, [one for one, keeps in zip(asked, typical, strict=True) if keeps]):
        boxes = [view.box for one in shown for view in one.views if view.frame == frame]
        pages.append(photo(boxed(rgb, boxes, SIGN_INK), f"image {frame}: {len(boxes)} segments"))
    return figure("5.3, 5.4").shown("; ".join(words), *pages)


def residual_figure(drive: Drive) -> Figure:
    """Figure 7.2: eq. 7.5 by straight motion and by the adjusted one, image by image."""
    frames, steps = np.array(sorted(drive.frames)), [m for _, m in sorted(drive.frames.items())]
    straight = np.array([m.residual_straight_px for m in steps])
    adjusted = np.array([m.residual_px for m in steps])
    good = np.isfinite(straight)
    if not good.any():
        return figure("7.2").left_out("two images that follow each other")
    rotations = np.array([np.eye(3) if m.step is None else m.step.rotation for m in steps])
    turns = np.degrees(np.arctan2(rotations[:, 0, 2], rotations[:, 2, 2]))
    top = 1.1 * float(np.nanmax([straight, adjusted]))
    span = (float(frames[0]), float(frames[-1]))
    axes = new_axes(span, (0, top), ("image", "residual per coordinate, px"))
    axes.plot(frames, straight, color=INKS[1], label="straight motion")
    axes.plot(frames, adjusted, color=INKS[2], label="motion that is used")
    bent = np.abs(turns) > 0.5
    words = ", ".join(
        f"{np.median(straight[rows]):.2f} px in {rows.sum()} steps that turn by {kind} than half a degree"
        for rows, kind in ((good & ~bent, "less"), (good & bent, "more"))
        if rows.any()
    )
    median = float(np.nanmedian(adjusted[good]))
    ours = f"median of straight motion {words}; of the motion that is used {median:.2f} px"
    return figure("7.2").shown(ours, svg(axes))


def scene_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 8.3 to 8.6."""
    for number, show in (("8.3 to 8.5", _scene), ("8.6", _size)):
        lacking = figure(number).left_out("signs in three dimensions")
        yield show(drive, drive.signs) if drive.signs else lacking


def _track(drive: Drive, sign: Landmark) -> Figure:
    views = sorted(sign.views, key=lambda view: view.frame)
    some = evenly(views, 4)
    images = drive.images({view.frame for view in some})
    crops = []
    for view in some:
        rgb = images[view.frame]
        corners = around(view.box, rgb.shape[:2], times=6, least=160)
        crops.append(cut(boxed(rgb, [view.box], SIGN_INK), corners, 230))
    page = images[views[-1].frame].copy()
    path = np.array([(view.u_px, view.v_px) for view in views])
    cv2.polylines(page, [np.rint(path).astype(np.int32)[:, None]], False, SIGN_INK, 3, cv2.LINE_AA)
    for u, v in path:
        cv2.circle(page, (round(u), round(v)), 7, SIGN_INK, -1, cv2.LINE_AA)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    lengths = ", ".join(f"{length:.0f}" for length in steps)
    return figure("5.2").shown(
        f"{len(views)} images, frames {views[0].frame} to {views[-1].frame}; "
        f"it moves by {lengths} px from image to image",
        photo(beside(crops)),
        photo(page, "its path in the last image", scale=0.5),
    )


def _named(sign: Landmark) -> str:
    words = " ".join(word for word in (sign.color, sign.shape) if word)
    return words.replace("_", " ") or "sign"


def _scene(drive: Drive, signs: list[Landmark]) -> Figure:
    places = np.array([one.best_pose.to_world(one.position) for one in signs])
    path = np.array([m.pose.centre for _, m in sorted(drive.frames.items())])
    far = max(float(path[:, 2].max()), float(places[:, 2].max()))
    span = (float(min(path[:, 2].min(), 0)), far + 5)
    words = ("ahead of the first camera, m", "left of its axis, m")
    above = new_axes(span, (-SCENE_M, SCENE_M), words, (1080, 420), equal=True)
    points = [
        m.pose.to_world(m.ties.point[m.ties.inlier & (np.abs(m.ties.point) < SCENE_M).all(axis=1)])
        for _, m in sorted(drive.frames.items())
        if m.ties is not None
    ]
    ground = np.concatenate([np.zeros((0, 3)), *points])
    some = ground[:: max(len(ground) // 3000, 1)]
    above.scatter(some[:, 2], -some[:, 0], 2, color="#b8c0c8", label="tie points", rasterized=True)
    above.plot(path[:, 2], -path[:, 0], color=TEXT, label="camera")
    words = ("right of the path, m", "above the camera, m")
    across = new_axes((-15, 15), (-3, 8), words, (640, 300), equal=True)
    right, up = np.array([(one.right_m, one.above_m) for one in signs]).T
    inks = [np.divide(COLOR_RGB.get(one.color or "", (150,) * 3), 255) for one in signs]
    above.scatter(places[:, 2], -places[:, 0], 60, color=inks, edgecolor=FAINT)
    across.scatter(right, up, 60, color=inks, edgecolor=FAINT)
    for one, (x, _, z) in zip(signs, places, strict=True):
        if drive.judge(one) == ON:
            above.annotate(_named(one), (z, -x), (5, 4), textcoords="offset points", color=FAINT)
    across.plot(*KANSAS_MEAN, "o", color=TEXT, label="report's mean sign")
    return figure("8.3 to 8.5").shown(
        f"{len(signs)} signs, {(right < 0).sum()} left and {(right >= 0).sum()} right of the path, at "
        f"{np.median(np.abs(right)):.1f} m from it (median); "
        "the report's mean sign is 3.1 m right, 0.6 m above the camera",
        svg(above, "from above; named: on labelled signs"),
        svg(across, "across the road"),
    )


def _size(drive: Drive, signs: list[Landmark]) -> Figure:
    listed = [sign for sign in signs if drive.judge(sign) == ON] or signs
    # that of the report is one whose size the adjustment gave well
    one = min(listed, key=lambda sign: sign.sigma_width_m / sign.width_m)
    wide, tall = one.width_m / FEET, one.height_m / FEET
    ends = [(-0.5, max(pair) + 1) for pair in zip((wide, tall), REPORT_SIZE_FT, strict=True)]
    axes = new_axes(ends[0], ends[1], ("ft", "ft"), (420, 320), equal=True)
    shown = ((wide, tall, 0, "-", "the sign"), (*REPORT_SIZE_FT, 1, "--", "the report's sign"))
    for x, y, ink, style, name in shown:
        axes.plot([0, x, x, 0, 0], [0, 0, y, y, 0], style, color=INKS[ink], label=name)
    sizes: list[Sequence[str]] = [
        ("sign", "on a labelled sign", "width ft", "height ft", "width m", "height m")
    ]
    for sign in listed:
        pairs = ((sign.width_m, sign.sigma_width_m), (sign.height_m, sign.sigma_height_m))
        feet = (f"{size / FEET:.1f} ± {sigma / FEET:.1f}" for size, sigma in pairs)
        width, height = (f"{size:.2f}" for size, _ in pairs)
        name = f"{_named(sign)}, frame {sign.best_frame}"
        sizes.append((name, _JUDGED[drive.judge(sign)], *feet, width, height))
    return figure("8.6").shown(
        f"the sign of the surest width, {_named(one)}: {wide:.1f} ± {one.sigma_width_m / FEET:.1f} ft wide, "
        f"{tall:.1f} ± {one.sigma_height_m / FEET:.1f} ft high, by its boxes in {len(one.views)} images; "
        f"{len(signs) - len(listed)} rows that are on no labelled sign are not listed",
        svg(axes),
        table=sizes,
    )


REPORT_IMAGES = 100
_KEY = "yellow: on a labelled sign; pink: on none; grey: not known"
_INKS = {ON: SIGN_INK, OFF: ACCENT, NEITHER: (170, 170, 170)}


def result_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 11.1 and 11.2, and the claim."""
    signs = drive.signs
    judged = {one.track_id: drive.judge(one) for one in signs}
    busiest = [k for k, _ in Counter(v.frame for one in signs for v in one.views).most_common()]
    # the busiest, and the next one, if possible some way from it
    frames = busiest[:1] + sorted(busiest[1:], key=lambda k: abs(k - busiest[0]) <= 5)[:1]
    images = drive.images(frames)
    if not images:
        yield figure("11.1").left_out("a sign that is found")
    for number, frame in zip(("11.1", "11.2"), sorted(images), strict=False):
        page = images[frame]
        for kind, ink in _INKS.items():
            own = [one for one in signs if judged[one.track_id] == kind]
            boxes = [view.box for one in own for view in one.views if view.frame == frame]
            page = boxed(page, boxes, ink, 4)
        here = [one for one in signs if any(view.frame == frame for view in one.views)]
        right = sum(judged[one.track_id] == ON for one in here)
        words = f"frame {frame}: {len(here)} found, {right} of them on labelled signs"
        yield figure(number).shown(words, photo(page, _KEY, scale=0.6))
    yield _claim(drive, judged)


def _claim(drive: Drive, judged: dict[int, int]) -> Figure:
    """Of the labelled panels that are seen large and whole in enough images, how many are found."""
    views: defaultdict[str, dict[int, Box]] = defaultdict(dict)
    for frame, own in drive.labels.labels.items():
        for one in own:
            clear = one.visible is None or one.visible >= 0.5
            if one.kind == SIGN and one.wanted and one.panel and clear and one.height_px >= 10:
                views[one.panel][frame] = one.box
    wanted = [boxes for boxes in views.values() if len(boxes) >= FEWEST_FRAMES]
    reported = [view for one in drive.signs for view in one.views]
    found = sum(
        any(v.frame in boxes and same_thing(v.box, boxes[v.frame]) for v in reported)
        for boxes in wanted
    )
    images = len(drive.frames)
    false = sum(kind == OFF for kind in judged.values())
    few = "" if images >= REPORT_IMAGES else f"; the drive has fewer than {REPORT_IMAGES} images"
    return figure("11 (claim)").shown(
        f"labelled signs of {FEWEST_FRAMES} images or more that are found: {share_words(found, len(wanted))}; reported "
        f"places on no sign: {rate_words(false, images)}{few}"
    )
