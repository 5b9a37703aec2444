"""Chapter 4: outlines and their Fourier descriptors, and the claim of 92 % on 50 images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.page import Figure
from wayside.pipeline.report_figures.drawing import Ink, around, beside, lined, photo
from wayside.pipeline.report_figures.gather import Drive, FaceOutline
from wayside.pipeline.statistics import share_words
from wayside.pipeline.view.outlines import CURVES, INKS, curve_of_terms

REPORT_IMAGES, REPORT_FOUND = 50, 0.92
_TALL, _MOST = 300, 4

View = list[FaceOutline]
"""The outlines on one face in one image."""


def shape_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 4.1 and 4.2, and the claim."""
    views = views_with_shape(drive)
    missed = [view for view in views if not right(drive, view)]
    shown = _largest_of_each_shape(drive, views)
    worst = sorted(missed, key=lambda view: -_size(view))[:_MOST]
    images = drive.images({view[0].frame for view in (*shown, *worst)})
    yield _curves(drive, images, shown)
    yield _false_negatives(drive, images, worst)
    yield _claim(drive, views)


def views_with_shape(drive: Drive) -> list[View]:
    """The outlines of each labelled face of a known shape in each image, in order."""
    known = [one for one in drive.outlines if drive.faces.shape[one.face]]
    return [list(own) for _, own in groupby(known, key=lambda one: (one.frame, one.face))]


def right(drive: Drive, view: View) -> bool:
    """Whether one of its outlines is accepted with the right shape."""
    return any(one.accepted and one.named == drive.faces.shape[one.face] for one in view)


def evenly(views: Sequence[View], count: int) -> list[View]:
    """At most so many, evenly along the drive."""
    at = np.unique(np.linspace(0, len(views) - 1, min(len(views), count)).round().astype(int))
    return [views[i] for i in at] if views else []


def misfit(sequence: NDArray[np.complex128], terms: tuple[int, ...]) -> float:
    """RMS distance of an outline from the curve of its terms, as a share of its mean radius."""
    curve = curve_of_terms(sequence[None], terms)[0]
    radius = np.abs(sequence - sequence.mean()).mean()
    return float(np.sqrt((np.abs(sequence - curve) ** 2).mean()) / radius)


def _size(view: View) -> float:
    return max(float(np.prod(one.box[2:] - one.box[:2])) for one in view)


def _largest(view: View) -> FaceOutline:
    return max(view, key=lambda one: float(np.prod(one.box[2:] - one.box[:2])))


def _largest_of_each_shape(drive: Drive, views: Sequence[View]) -> list[View]:
    best: dict[str, View] = {}
    for view in views:
        shape = drive.faces.shape[view[0].face]
        if right(drive, view) and (shape not in best or _size(view) > _size(best[shape])):
            best[shape] = view
    return sorted(best.values(), key=lambda view: -_size(view))[:_MOST]


def _drawn(
    images: dict[int, NDArray[np.uint8]], one: FaceOutline, curves: Sequence[str]
) -> NDArray[np.uint8] | None:
    rgb = images.get(one.frame)
    if rgb is None:
        return None
    corners = around(one.box, rgb.shape[:2], times=1.5, least=24)
    strips: list[tuple[NDArray[np.complex128], Ink]] = [(one.sequence, INKS["traced"])]
    strips += [(curve_of_terms(one.sequence[None], CURVES[name])[0], INKS[name]) for name in curves]
    return lined(rgb, corners, _TALL, strips)


def _curves(drive: Drive, images: dict[int, NDArray[np.uint8]], shown: Sequence[View]) -> Figure:
    title = "circle, ellipse and curve of six terms fitted to outlines"
    report = "an outline is described by its first Fourier terms; six descriptors are used"
    crops = [_drawn(images, _largest(view), tuple(CURVES)) for view in shown]
    drawn = [image for image in crops if image is not None]
    if not drawn:
        return Figure("4.1", title, report, needs="a labelled sign whose outline is recognised")
    rows = [("shape", *(name.replace("_", " ") for name in CURVES))]
    for view in shown:
        one = _largest(view)
        errors = [f"{100 * misfit(one.sequence, terms):.1f} %" for terms in CURVES.values()]
        rows.append((drive.faces.shape[one.face], *errors))
    words = "white: traced; orange: circle; blue: ellipse; pink: six terms"
    return Figure(
        "4.1",
        title,
        report,
        "distance of the outline from each curve, RMS, as a share of its mean radius:",
        (photo(beside(drawn), words),),
        table=tuple(rows),
    )


def _false_negatives(
    drive: Drive, images: dict[int, NDArray[np.uint8]], worst: Sequence[View]
) -> Figure:
    title, report = "signs whose shape is missed", "8 % are missed: boundaries are irregular"
    crops = [_drawn(images, _largest(view), ()) for view in worst]
    drawn = [image for image in crops if image is not None]
    if not drawn:
        return Figure("4.2", title, report, "none of the labelled signs is missed")
    told = [
        f"{drive.faces.shape[one.face]} taken for {one.named} at {one.distance:.1f}"
        + ("" if one.accepted else ", too far")
        for one in map(_largest, worst)
    ]
    return Figure("4.2", title, report, "; ".join(told), (photo(beside(drawn), "traced outlines"),))


def _claim(drive: Drive, views: Sequence[View]) -> Figure:
    sample = evenly(views, REPORT_IMAGES)
    hits = sum(right(drive, view) for view in sample)
    found = sum(any(one.accepted for one in view) for view in sample)
    every = sum(right(drive, view) for view in views)
    return Figure(
        "4 (claim)",
        "the shape is right on 50 images",
        f"{100 * REPORT_FOUND:.0f} % found of {REPORT_IMAGES}, 8 % missed",
        f"views of labelled signs that reach the classifier, evenly along the drive: right "
        f"{share_words(hits, len(sample))}; "
        f"some sign shape {share_words(found, len(sample))}; right on all {share_words(every, len(views))}. "
        "The intervals take views as independent, which those of one sign are not",
    )
