"""Chapter 11: what is found on the whole drive, and the claim of almost no false positives on 100 images."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

import numpy as np

from wayside.pipeline.evaluation.rendered import FEWEST_FRAMES
from wayside.pipeline.labels.box_matching import overlap
from wayside.pipeline.learning.page import Figure
from wayside.pipeline.learning.samples import NEITHER, OFF, ON
from wayside.pipeline.report_figures.drawing import ACCENT, SIGN_INK, boxed, photo
from wayside.pipeline.report_figures.gather import Drive
from wayside.pipeline.statistics import rate_words, share_words
from wayside.schemas.labels import SIGN

REPORT_IMAGES = 100
_KEY = "yellow: on a labelled sign; pink: on none; grey: not known"
_INKS = {ON: SIGN_INK, OFF: ACCENT, NEITHER: (170, 170, 170)}

Boxes = list[tuple[int, tuple[float, ...]]]
"""Frames and boxes of one panel."""


def result_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 11.1 and 11.2, and the claim."""
    signs = drive.signs
    judged = {one.track_id: drive.judge(one) for one in signs}
    busiest = [k for k, _ in Counter(v.frame for one in signs for v in one.views).most_common()]
    # the busiest, and the next one some way from it
    frames = busiest[:1] + [k for k in busiest if abs(k - busiest[0]) > 5][:1]
    images = drive.images(frames)
    if not images:
        figure = Figure("11.1", "what is found", "all signs of an image")
        yield figure.left_out("a sign that is found")
    for number, frame in zip(("11.1", "11.2"), sorted(images), strict=False):
        page = images[frame]
        for kind, ink in _INKS.items():
            own = [one for one in signs if judged[one.track_id] == kind]
            boxes = [view.box for one in own for view in one.views if view.frame == frame]
            page = boxed(page, boxes, ink, 4)
        here = [one for one in signs if any(view.frame == frame for view in one.views)]
        right = sum(judged[one.track_id] == ON for one in here)
        figure = Figure(number, "what is found in an image", "all road signs are identified")
        words = f"frame {frame}: {len(here)} found, {right} of them on labelled signs"
        yield figure.shown(words, photo(page, _KEY, scale=0.6))
    yield _claim(drive, judged)


def wanted_panels(drive: Drive) -> dict[str, Boxes]:
    """Boxes of the labelled panels that should be found: seen large and whole in enough images."""
    views: defaultdict[str, Boxes] = defaultdict(list)
    for frame, own in drive.labels.labels.items():
        for one in own:
            clear = one.visible is None or one.visible >= 0.5
            if one.kind == SIGN and one.wanted and one.panel and clear and one.height_px >= 10:
                views[one.panel].append((frame, one.box))
    return {name: boxes for name, boxes in views.items() if len(boxes) >= FEWEST_FRAMES}


def _claim(drive: Drive, judged: dict[int, int]) -> Figure:
    wanted, images = wanted_panels(drive), len(drive.frames)
    found = sum(_is_found(drive, boxes) for boxes in wanted.values())
    false = sum(kind == OFF for kind in judged.values())
    few = "" if images >= REPORT_IMAGES else f"; the drive has fewer than {REPORT_IMAGES} images"
    report = 'all road signs were identified, with "almost no false positives"; no counts are given'
    return Figure("11 (claim)", f"{REPORT_IMAGES} images", report).shown(
        f"labelled signs of {FEWEST_FRAMES} images or more that are found: {share_words(found, len(wanted))}; reported "
        f"places on no sign: {rate_words(false, images)}{few}"
    )


def _is_found(drive: Drive, boxes: Boxes) -> bool:
    by_frame = dict(boxes)
    return any(
        view.frame in by_frame and overlap(np.array([view.box]), by_frame[view.frame])[0] > 0
        for one in drive.signs
        for view in one.views
    )
