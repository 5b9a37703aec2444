"""Chapter 11: what is found on the whole drive, and the claim of almost no false positives on 100 images."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

import numpy as np

from wayside.pipeline.box_matching import overlap
from wayside.pipeline.evaluation import FEWEST_FRAMES
from wayside.pipeline.learning.samples import OFF, ON
from wayside.pipeline.report_figures.drawing import ACCENT, SIGN_INK, boxed
from wayside.pipeline.report_figures.gather import Drive
from wayside.pipeline.report_figures.numbers import rate_words, share_words
from wayside.pipeline.report_figures.page import Figure, photo
from wayside.schemas.labels import SIGN

REPORT_IMAGES = 100


def result_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 11.1 and 11.2, and the claim."""
    signs = drive.signs
    judged = {one.track_id: drive.judge(one) for one in signs}
    busiest = Counter(view.frame for one in signs for view in one.views).most_common()
    frames = sorted({frame for frame, _ in busiest[:1]} | {_apart(busiest)} - {-1})
    images = drive.images(frames)
    if not images:
        yield Figure("11.1", "what is found", "all signs of an image", needs="a sign that is found")
    for number, frame in zip(("11.1", "11.2"), sorted(images), strict=False):
        page = images[frame]
        for ink, kinds in ((SIGN_INK, (ON,)), (ACCENT, (OFF,)), ((170, 170, 170), (-1,))):
            boxes = [
                view.box
                for one in signs
                for view in one.views
                if view.frame == frame and judged[one.track_id] in kinds
            ]
            page = boxed(page, boxes, ink, 4)
        here = [one for one in signs if any(view.frame == frame for view in one.views)]
        right = sum(judged[one.track_id] == ON for one in here)
        yield Figure(
            number,
            "what is found in an image",
            "all road signs are identified",
            f"frame {frame}: {len(here)} found, {right} of them on labelled signs",
            (photo(page, "yellow: on a labelled sign; pink: on none; grey: not known", scale=0.6),),
        )
    yield _claim(drive, judged)


def wanted_panels(drive: Drive) -> dict[str, list[tuple[int, tuple[float, ...]]]]:
    """Boxes (frame, box) of the labelled panels that should be found: seen large and whole in enough images."""
    views: defaultdict[str, list[tuple[int, tuple[float, ...]]]] = defaultdict(list)
    for frame, own in drive.labels.labels.items():
        for one in own:
            clear = one.visible is None or one.visible >= 0.5
            if one.kind == SIGN and one.wanted and one.panel and clear and one.height_px >= 10:
                views[one.panel].append((frame, one.box))
    return {name: boxes for name, boxes in views.items() if len(boxes) >= FEWEST_FRAMES}


def _apart(busiest: list[tuple[int, int]]) -> int:
    """The frame of most signs some way from the very busiest; -1 where there is none."""
    first = busiest[0][0] if busiest else 0
    return next((frame for frame, _ in busiest if abs(frame - first) > 5), -1)


def _claim(drive: Drive, judged: dict[int, int]) -> Figure:
    wanted = wanted_panels(drive)
    found = sum(_is_found(drive, boxes) for boxes in wanted.values())
    false = sum(kind == OFF for kind in judged.values())
    images = len(drive.frames)
    return Figure(
        "11 (claim)",
        f"{REPORT_IMAGES} images",
        'all road signs were identified, with "almost no false positives"; no counts are given',
        f"labelled signs of {FEWEST_FRAMES} images or more that are found: {share_words(found, len(wanted))}; reported "
        f"places on no sign: {rate_words(false, images)}"
        + ("" if images >= REPORT_IMAGES else f"; the drive has fewer than {REPORT_IMAGES} images"),
    )


def _is_found(drive: Drive, boxes: list[tuple[int, tuple[float, ...]]]) -> bool:
    by_frame = dict(boxes)
    return any(
        view.frame in by_frame and overlap(np.array([view.box]), by_frame[view.frame])[0] > 0
        for one in drive.signs
        for view in one.views
    )
