"""Chapter 4: outlines and their Fourier descriptors, and the claim of 92 % on 50 images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.page import Figure
from wayside.pipeline.report_figures.drawing import around, beside, lined, photo
from wayside.pipeline.report_figures.gather import Drive, FaceOutline, evenly
from wayside.pipeline.statistics import share_words
from wayside.pipeline.view.drawing import CURVES, INKS, curve_of_terms

REPORT_IMAGES, REPORT_FOUND = 50, 0.92
_TALL, _MOST = 300, 4

View = list[FaceOutline]
"""The outlines on one face in one image."""
Images = dict[int, NDArray[np.uint8]]


def shape_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 4.1 and 4.2, and the claim."""
    views = views_with_shape(drive)
    by_size = sorted(views, key=lambda view: -_area(_largest(view)))
    found = [view for view in by_size if right(drive, view)]
    # the largest of each shape
    shown = list({drive.faces.shape[view[0].face]: view for view in reversed(found)}.values())
    shown = sorted(shown, key=lambda view: -_area(_largest(view)))[:_MOST]
    worst = [view for view in by_size if not right(drive, view)][:_MOST]
    images = drive.images({view[0].frame for view in (*shown, *worst)})
    yield _curves(drive, images, [_largest(view) for view in shown])
    yield _false_negatives(drive, images, [_largest(view) for view in worst])
    yield _claim(drive, views)


def views_with_shape(drive: Drive) -> list[View]:
    """The outlines of each labelled face of a known shape in each image, in order."""
    known = [one for one in drive.outlines if drive.faces.shape[one.face]]
    return [list(own) for _, own in groupby(known, key=lambda one: (one.frame, one.face))]


def right(drive: Drive, view: View) -> bool:
    """Whether one of its outlines is accepted with the right shape."""
    return any(one.accepted and one.named == drive.faces.shape[one.face] for one in view)


def misfit(sequence: NDArray[np.complex128], terms: tuple[int, ...]) -> float:
    """RMS distance of an outline from the curve of its terms, as a share of its mean radius."""
    curve = curve_of_terms(sequence[None], terms)[0]
    radius = np.abs(sequence - sequence.mean()).mean()
    return float(np.sqrt((np.abs(sequence - curve) ** 2).mean()) / radius)


def _area(one: FaceOutline) -> float:
    return float(np.prod(one.box[2:] - one.box[:2]))


def _largest(view: View) -> FaceOutline:
    return max(view, key=_area)


def _drawn(
    images: Images, outlines: Sequence[FaceOutline], curves: Sequence[str]
) -> NDArray[np.uint8] | None:
    crops = []
    for one in outlines:
        if (rgb := images.get(one.frame)) is not None:
            corners = around(one.box, rgb.shape[:2], times=1.5, least=24)
            terms = [(curve_of_terms(one.sequence[None], CURVES[k])[0], INKS[k]) for k in curves]
            crops.append(lined(rgb, corners, _TALL, [(one.sequence, INKS["traced"]), *terms]))
    return beside(crops) if crops else None


def _curves(drive: Drive, images: Images, shown: Sequence[FaceOutline]) -> Figure:
    title = "circle, ellipse and curve of six terms fitted to outlines"
    report = "an outline is described by its first Fourier terms; six descriptors are used"
    figure = Figure("4.1", title, report)
    drawn = _drawn(images, shown, tuple(CURVES))
    if drawn is None:
        return figure.left_out("a labelled sign whose outline is recognised")
    rows = [("shape", *(name.replace("_", " ") for name in CURVES))]
    for one in shown:
        errors = [f"{100 * misfit(one.sequence, terms):.1f} %" for terms in CURVES.values()]
        rows.append((drive.faces.shape[one.face], *errors))
    words = "white: traced; orange: circle; blue: ellipse; pink: six terms"
    ours = "distance of the outline from each curve, RMS, as a share of its mean radius:"
    return figure.shown(ours, photo(drawn, words), table=rows)


def _false_negatives(drive: Drive, images: Images, worst: Sequence[FaceOutline]) -> Figure:
    title, report = "signs whose shape is missed", "8 % are missed: boundaries are irregular"
    figure, drawn = Figure("4.2", title, report), _drawn(images, worst, ())
    if drawn is None:
        return figure.shown("none of the labelled signs is missed")
    told = [
        f"{drive.faces.shape[one.face]} taken for {one.named} at {one.distance:.1f}"
        + ("" if one.accepted else ", too far")
        for one in worst
    ]
    return figure.shown("; ".join(told), photo(drawn, "traced outlines"))


def _claim(drive: Drive, views: Sequence[View]) -> Figure:
    sample = evenly(views, REPORT_IMAGES)
    hits = sum(right(drive, view) for view in sample)
    found = sum(any(one.accepted for one in view) for view in sample)
    every = sum(right(drive, view) for view in views)
    report = f"{100 * REPORT_FOUND:.0f} % found of {REPORT_IMAGES}, 8 % missed"
    return Figure("4 (claim)", "the shape is right on 50 images", report).shown(
        f"views of labelled signs that reach the classifier, evenly along the drive: right "
        f"{share_words(hits, len(sample))}; some sign shape {share_words(found, len(sample))}; right on all "
        f"{share_words(every, len(views))}. The intervals take views as independent, which those of one sign are not"
    )
