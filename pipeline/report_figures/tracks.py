"""Chapters 5 to 8 and 11: tracks, calibration, residuals of the motion, the scene, and what is found."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wayside.pipeline.calibration.boards import (
    CalibratedImages,
    calibrate_images,
    draw_coverage,
    parse_board,
)
from wayside.pipeline.evaluation.rendered import FEWEST_FRAMES
from wayside.pipeline.labels.box_matching import same_thing
from wayside.pipeline.learning.gates import KANSAS_MEAN
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON
from wayside.pipeline.learning.page import CLAIMS, FAINT, INKS, TEXT, Figure, Picture, new_axes, svg
from wayside.pipeline.report_figures.drive import (
    ACCENT,
    ALMOST_NO,
    IMAGE_WIDE,
    NEARLY_ALL,
    SIGN_INK,
    Drive,
    beside,
    boxed,
    evenly,
    figure,
    photo,
    reached,
)
from wayside.pipeline.statistics import rate_words, share_words
from wayside.schemas.detections import COLOR_RGB, box_centers
from wayside.schemas.landmarks import Landmark, Observation
from wayside.stages.geometry import ideal_points
from wayside.stages.report import track_log_ratio

FEET = 0.3048
REPORT_SIZE_FT = (3.5, 2.0)
SCENE_M = 25.0
"""Points of the scene are drawn up to this distance from the camera, and to the side of its path."""


def track_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 5.1 to 5.4."""

    def rank(one: Landmark) -> tuple[bool, int, float]:
        """The largest sign of four views or of the most, on a labelled one if there is any."""
        return drive.judge(one) == ON, min(len(one.views), 4), one.best_box[3] - one.best_box[1]

    if drive.signs:
        shown = max(drive.signs, key=rank)
        yield from _track(drive, sorted(shown.views, key=lambda view: view.frame))
    yield from _trajectories(drive)


def board_figure(boards: list[Path], board: str | None) -> Iterator[Figure]:
    """Figure 6.1, by images of a chessboard where some are given."""
    if not boards or board is None:
        return
    found = calibrate_images(boards, parse_board(board, float("nan")), "plumb_bob")
    one = found.calibration
    yield figure("6.1").shown(
        f"{sum(view.used for view in one.views)} of {len(found.images)} images used, {one.rms_px:.2f} px RMS, fx "
        f"{one.camera.fx:.1f} px, fy {one.camera.fy:.1f} px, centre {one.camera.cx:.1f}, {one.camera.cy:.1f} px",
        *_undistorted(found),
        photo(draw_coverage(found)[..., ::-1], "corners of all images", IMAGE_WIDE),
    )


def _undistorted(found: CalibratedImages) -> Iterator[Picture]:
    """The largest view of the board before and after undistortion, its rows joined."""
    camera, board = found.calibration.camera, found.board
    views = [(one.path, np.array(one.corners)) for one, view in found.seen if view.used]
    path, seen = max(views, key=lambda one: float(np.ptp(one[1], axis=0).prod()))
    bent = np.asarray(cv2.imread(str(path)), np.uint8)
    flat = np.asarray(cv2.undistort(bent, camera.matrix, np.array(camera.distortion)), np.uint8)
    straight = ideal_points(camera, seen)
    for page, corners, when in ((bent, seen, "before"), (flat, straight, "after")):
        rows = corners.reshape(board.rows, board.columns, 2)
        cv2.polylines(page, list(np.rint(rows).astype(np.int32)), False, ACCENT, 2, cv2.LINE_AA)
        yield photo(page[..., ::-1], f"{path.name} {when} undistortion", IMAGE_WIDE)


def _trajectories(drive: Drive) -> Iterator[Figure]:
    """Figures 5.3 and 5.4: one image with all tracks on it, and with those that move as signs do."""
    asked = [one for one in drive.landmarks if one.verdict in ("sign", "location", "duplicate")]
    if not asked:
        return
    density = drive.density
    typical = [track_log_ratio(one, density) >= density.threshold for one in asked]
    words, right = [], []
    for what, label in (("tracks on signs kept", ON), ("others removed", OFF)):
        right = [
            keeps == (label == ON)
            for one, keeps in zip(asked, typical, strict=True)
            if drive.judge(one) == label
        ]
        words.append(f"{what} {share_words(sum(right), len(right))}")
    counts = Counter(view.frame for one in asked for view in one.views)
    frame = max(counts, key=lambda k: (counts[k], -k))
    rgb = drive.images({frame})[frame]
    pages, kept = [], [one for one, keeps in zip(asked, typical, strict=True) if keeps]
    for when, shown in (("before", asked), ("after", kept)):
        boxes = [view.box for one in shown for view in one.views if view.frame == frame]
        key = f"image {frame}, {when}: {len(boxes)} segments"
        pages.append(photo(boxed(rgb, boxes, SIGN_INK), key, IMAGE_WIDE))
    claim = reached(sum(right), len(right), NEARLY_ALL)
    yield figure("5.3, 5.4").shown("; ".join(words), *pages, claim=claim)


def residual_figure(drive: Drive) -> Iterator[Figure]:
    """Figure 7.2: eq. 7.5 by straight motion and by the adjusted one, image by image."""
    frames, steps = np.array(sorted(drive.frames)), [m for _, m in sorted(drive.frames.items())]
    straight = np.array([m.residual_straight_px for m in steps])
    adjusted = np.array([m.residual_px for m in steps])
    good = np.isfinite(straight)
    if not good.any():
        return
    rotations = np.array([np.eye(3) if m.step is None else m.step.rotation for m in steps])
    turns = np.degrees(np.arctan2(rotations[:, 0, 2], rotations[:, 2, 2]))
    top = 1.1 * float(np.nanmax([straight, adjusted]))
    span = (float(frames[0]), float(frames[-1]))
    axes = new_axes(span, (0, top), ("image", "residual per coordinate, px"))
    axes.plot(frames, straight, color=INKS[1], label="straight motion")
    axes.plot(frames, adjusted, color=INKS[2], label="motion that is used")
    axes.axhline(limit := drive.settings.motion.residual_px, color=FAINT, linestyle=":")
    bent, high = np.abs(turns) > 0.5, good & (straight > limit)
    words = ", ".join(
        f"{np.median(straight[rows]):.2f} px in {rows.sum()} steps that turn by {kind} than half a degree"
        for rows, kind in ((good & ~bent, "less"), (good & bent, "more"))
        if rows.any()
    )
    low = int((adjusted[high] <= limit).sum())
    ours = (
        f"median of straight motion {words}; of {good.sum()} steps {high.sum()} have more than {limit:g} px, and after "
        f"the adjustment of these {share_words(low, int(high.sum()))} have less"
    )
    claim = reached(low, int(high.sum()), NEARLY_ALL)
    yield figure("7.2").shown(ours, svg(axes, f"dotted: {limit:g} px"), claim=claim)


def scene_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 8.3 to 8.6."""
    for show in (_matches, _scene, _size) if drive.signs else ():
        yield show(drive, drive.signs)


def _matches(drive: Drive, signs: list[Landmark]) -> Figure:
    """Two images that follow each other, with the matches that signs consist of in yellow."""
    right = [view for one in signs if drive.judge(one) == ON for view in one.views[1:]]
    own = Counter(view.frame for view in right)
    frame = max(drive.matches, key=lambda k: (own[k], len(drive.matches[k]), -k))
    before = max(k for k in drive.frames if k < frame)
    images, matches = drive.images({before, frame}), drive.matches[frame]
    page = beside([images[before], images[frame]], 1)
    ends = np.add(matches, (0, 0, 0, len(page) // 2))
    held = np.array([view.box for view in right if view.frame == frame]).reshape(-1, 4)
    at = matches[:, None, 2:]
    on = np.any(np.all((at >= held[:, :2]) & (at <= held[:, 2:]), axis=2), axis=1)
    for kept, ink, width in ((~on, _INKS[NEITHER], 1), (on, SIGN_INK, 4)):
        for u0, v0, u1, v1 in np.rint(ends[kept]).astype(int).tolist():
            cv2.line(page, (u0, v0), (u1, v1), ink, width, cv2.LINE_AA)
    words = f"frames {before} and {frame}: {len(matches)} matches, {on.sum()} of them on labelled signs (yellow)"
    return figure("8.3").shown(words, photo(page, wide=IMAGE_WIDE))


def _track(drive: Drive, views: list[Observation]) -> Iterator[Figure]:
    some = evenly(views, 4)
    images = drive.images({view.frame for view in some})
    seen = [boxed(images[view.frame], [view.box + _AROUND], SIGN_INK, 6) for view in some]
    frames = ", ".join(str(view.frame) for view in some)
    yield figure("5.1").shown(f"frames {frames}, the sign boxed", photo(beside(seen, 2)))
    path = box_centers(np.array([view.box for view in views]))
    page = seen[-1]
    cv2.polylines(page, [np.rint(path).astype(np.int32)[:, None]], False, ACCENT, 4, cv2.LINE_AA)
    lengths = ", ".join(f"{n:.0f}" for n in np.linalg.norm(np.diff(path, axis=0), axis=1))
    yield figure("5.2").shown(
        f"{len(views)} images, frames {views[0].frame} to {views[-1].frame}; "
        f"it moves by {lengths} px from image to image",
        photo(page, "its path in the last image"),
    )


def _scene(drive: Drive, signs: list[Landmark]) -> Figure:
    places = np.array([one.best_pose.to_world(one.position) for one in signs])
    path = np.array([m.pose.centre for _, m in sorted(drive.frames.items())])
    right, up = np.array([(one.right_m, one.above_m) for one in signs]).T
    ahead, left = np.concatenate([path, places])[:, [2, 0]].T * ((1,), (-1,))
    words = ("ahead of the first camera, m", "left of its axis, m")
    above = new_axes(_span(ahead), _span(left), words)
    points = [
        m.pose.to_world(m.ties.point[m.ties.inlier & (np.abs(m.ties.point) < SCENE_M).all(axis=1)])
        for _, m in sorted(drive.frames.items())
        if m.ties is not None
    ]
    ground = np.concatenate([np.zeros((0, 3)), *points])
    some = ground[:: max(len(ground) // 3000, 1)]
    above.scatter(some[:, 2], -some[:, 0], 2, color="#b8c0c8", rasterized=True)
    above.plot(path[:, 2], -path[:, 0], color=TEXT, label="camera")
    words = ("right of the path, m", "above the camera, m")
    across = new_axes(_span([*right, KANSAS_MEAN[0]]), _span([*up, KANSAS_MEAN[1]]), words)
    inks = [np.divide(COLOR_RGB.get(one.color or "", (150,) * 3), 255) for one in signs]
    on = [drive.judge(one) == ON for one in signs]
    ring, width = np.where(on, TEXT, FAINT), np.where(on, 2.0, 0.5)
    for axes, x, y in ((above, places[:, 2], -places[:, 0]), (across, right, up)):
        axes.scatter(x, y, 50, color=inks, edgecolor=ring, linewidth=width)
    across.plot(*KANSAS_MEAN, "+", color=TEXT, markersize=14, label="report's mean sign")
    return figure("8.4, 8.5").shown(
        f"{len(signs)} signs, {(right < 0).sum()} left and {(right >= 0).sum()} right of the path, at "
        f"{np.median(np.abs(right)):.1f} m from it (median); "
        "the report's mean sign is 3.1 m right, 0.6 m above the camera",
        svg(above, "from above, with tie points; ringed: on labelled signs; scales differ"),
        svg(across, "across the road; scales differ"),
    )


def _span(values: ArrayLike) -> tuple[float, float]:
    """Ends of an axis that holds all values."""
    margin = 0.05 * float(np.ptp(values)) + 1
    return float(np.min(values)) - margin, float(np.max(values)) + margin


def _size(drive: Drive, signs: list[Landmark]) -> Figure:
    listed = [sign for sign in signs if drive.judge(sign) == ON] or signs
    # the report reads its size from points
    one = max(listed, key=lambda sign: dict(sign.evidence).get("rigidity", 0.0))
    wide, tall = one.width_m / FEET, one.height_m / FEET
    ends = [(-1, np.ceil(max(p)) + 1) for p in zip((wide, tall), REPORT_SIZE_FT, strict=True)]
    axes = new_axes(ends[0], ends[1], ("ft", "ft"), equal=True)
    axes.set(xticks=np.arange(-1, ends[0][1] + 1), yticks=np.arange(-1, ends[1][1] + 1))
    shown = ((wide, tall, 0, "-", "the sign"), (*REPORT_SIZE_FT, 1, "--", "the report's sign"))
    for x, y, ink, style, name in shown:
        axes.plot([0, x, x, 0, 0], [0, 0, y, y, 0], style, color=INKS[ink], label=name)
    return figure("8.6").shown(
        f"the {(one.color or '').replace('_', ' ')} sign whose points agree best: {wide:.1f} ± "
        f"{one.sigma_width_m / FEET:.1f} ft wide, {tall:.1f} ± {one.sigma_height_m / FEET:.1f} ft high, by its boxes "
        f"in {len(one.views)} images",
        svg(axes),
    )


_KEY = "yellow: on a labelled sign; pink: on none; grey: not known"
_INKS = {ON: SIGN_INK, OFF: ACCENT, NEITHER: (170, 170, 170)}
_PASSED, _AROUND = (0, 170, 255), np.array([-6, -6, 6, 6])


def result_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 11.1 and 11.2, and the claim."""
    signs = drive.signs
    judged = {one.track_id: drive.judge(one) for one in signs}
    right = [one for one in signs if judged[one.track_id] == ON] or signs
    busiest = [k for k, _ in Counter(v.frame for one in right for v in one.views).most_common()]
    # the busiest, and the next one, if possible some way from it
    frames = busiest[:1] + sorted(busiest[1:], key=lambda k: abs(k - busiest[0]) <= 5)[:1]
    images = drive.images(frames)
    for number, frame in zip(("11.1", "11.2"), sorted(images), strict=False):
        passed = drive.passed[frame]
        before = boxed(images[frame], list(passed), _PASSED, 2)
        page = images[frame]
        for kind, ink in _INKS.items():
            own = [one for one in signs if judged[one.track_id] == kind]
            boxes = [view.box for one in own for view in one.views if view.frame == frame]
            page = boxed(page, boxes, ink, 4)
        here = [judged[one.track_id] for one in signs for v in one.views if v.frame == frame]
        words = f"frame {frame}: {len(passed)} segments pass size and colour; {len(here)} places are found, "
        yield figure(number).shown(
            f"{words}{here.count(ON)} of them on labelled signs",
            photo(before, "all that pass size and colour", IMAGE_WIDE),
            photo(page, f"signs: {_KEY}", IMAGE_WIDE),
        )
    yield _claim(drive, judged)


def _claim(drive: Drive, judged: dict[int, int]) -> Figure:
    """Of the labelled panels that are seen large and whole in enough images, how many are found."""
    wanted = np.flatnonzero(np.bincount(drive.faces.sign[drive.faces.example]) >= FEWEST_FRAMES)
    faces, reported = drive.faces, [view for one in drive.signs for view in one.views]
    rows = np.flatnonzero(faces.example & np.isin(faces.sign, wanted))
    pairs = [(row, view) for row in rows for view in reported if view.frame == faces.frame[row]]
    found = len({faces.sign[row] for row, v in pairs if same_thing(v.box, faces.box[row])})
    images = len(drive.faces.complete & drive.frames.keys())  # elsewhere none is known to be false
    false = sum(kind == OFF for kind in judged.values())
    return figure("11 (claim)").shown(
        f"labelled signs of {FEWEST_FRAMES} images or more that are found: {share_words(found, len(wanted))}; "
        f"reported places on no sign where all signs are labelled: {rate_words(false, images)}",
        claim=min(
            reached(found, len(wanted), 1.0),
            reached(max(images - false, 0), images, 1 - ALMOST_NO),
            key=CLAIMS.index,
        ),
    )
