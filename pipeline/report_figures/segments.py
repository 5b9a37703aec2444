"""Chapters 2 to 4: segmentation by K-means in two passes, the size gate, the colour and the shape classifier."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.asked import ClassifierSamples
from wayside.pipeline.learning.labelled import OFF, ON
from wayside.pipeline.learning.page import INKS, TEXT, Figure, Picture, new_axes, svg
from wayside.pipeline.report_figures.decisions import color_curves, rates_at
from wayside.pipeline.report_figures.drive import (
    IMAGE_WIDE,
    NEARLY_ALL,
    Drive,
    FaceOutline,
    around,
    beside,
    boxed,
    clustered,
    cut,
    evenly,
    figure,
    lined,
    photo,
    reached,
)
from wayside.pipeline.statistics import share_words
from wayside.pipeline.view.drawing import CURVES, curve_of_terms
from wayside.pipeline.view.drawing import INKS as OUTLINE_INKS
from wayside.schemas.detections import SOURCES, Segmentation
from wayside.stages.geometry import box_areas

REPORT_GATE_PX = (50, 20_000)
TALL = 220
_MOST_CROPS = 8

Images = dict[int, NDArray[np.uint8]]


def segmentation_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 2.1 to 3.1."""
    faces = drive.faces
    rows = np.flatnonzero(faces.example & np.isin(faces.frame, list(drive.frames)))
    if not len(rows):
        yield from _size_gate(drive, None)
        return
    yellow, green = (
        rows[faces.color[rows] == color].tolist() or rows.tolist() for color in ("yellow", "green")
    )
    tall = (faces.box[:, 3] - faces.box[:, 1]).tolist()
    near, far = max(yellow, key=tall.__getitem__), min(green, key=tall.__getitem__)
    found = drive.segmented({int(faces.frame[row]) for row in (near, far)})
    near_one, far_one = (found[int(faces.frame[row])] for row in (near, far))
    yield _clustered(drive, "2.1", near_one, near)
    yield _clustered(drive, "2.2", far_one, far)
    yield _difference(drive, far_one, far)
    yield from _size_gate(drive, near_one)


def color_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 3.2 to 3.4."""
    samples = drive.samples["color"].known()
    size, chosen = box_areas(samples.box), []
    for number, color, on in (("3.2", "yellow", 1), ("3.3", "green", 0), ("3.4", "yellow", 0)):
        kind = samples.kind == color if on else samples.label == OFF
        rows = np.flatnonzero(kind & (samples.named == color))
        chosen.append((number, color, rows[np.argsort(-size[rows], kind="stable")]))
    crops = [evenly(rows.tolist(), _MOST_CROPS) for *_, rows in chosen]
    images = drive.images({int(samples.frame[row]) for own in crops for row in own})
    curves = color_curves(drive)
    for (number, color, rows), own in zip(chosen, crops, strict=True):
        ours, claim, one = f"no labelled {color} sign", "open", curves.get(color)
        if one is not None:
            found, (false, others) = rates_at(one, one.used)
            ours = f"in a run: TPR {share_words(*found)}, FPR {share_words(false, others)}"
            both = reached(*found, NEARLY_ALL), reached(others - false, others, NEARLY_ALL)
            claim = min(both, key=("not met", "open", "met").index)
        pictures = _crops(images, samples, own, len(rows))
        yield figure(number).shown(ours, *pictures, claim=claim if number == "3.2" else "")


def _clustered(drive: Drive, number: str, one: Segmentation, row: int) -> Figure:
    box, (rgb, shown) = drive.faces.box[row], clustered(one)
    margin = 0.2 * (box[2:] - box[:2])
    (x0, y0), (x1, y1) = np.maximum(np.rint([box[:2] + margin, box[2:] - margin]), 0).astype(int)
    inside = slice(y0, y1 + 1), slice(x0, x1 + 1)
    corners = around(box, rgb.shape[:2])
    pictures = beside([cut(rgb, corners, TALL), cut(shown, corners, TALL)])
    pixels = shown[inside].reshape(-1, 3)
    (color, count) = Counter(map(tuple, pixels.tolist())).most_common(1)[0]
    ours = (
        f"frame {one.frame.index}, {drive.faces.color[row] or 'unknown'} sign {box[2] - box[0]:.0f} x "
        f"{box[3] - box[1]:.0f} px, k = {len(one.palette)}: {100 * count / len(pixels):.0f} % of its "
        f"pixels are of one cluster, whose colour is {color}"
    )
    words = "the image, and in the colours of its clusters"
    return figure(number).shown(ours, photo(pictures, words))


def _difference(drive: Drive, one: Segmentation, row: int) -> Figure:
    rgb, shown = clustered(one)
    apart = np.linalg.norm(rgb - shown.astype(np.float32), axis=2)
    grey = np.minimum(np.rint(3 * apart), 255).astype(np.uint8)
    second, k = np.zeros_like(grey), len(one.difference_levels)
    if one.labels is not None:
        levels = np.linspace(-255, 255, k).clip(0).astype(np.uint8)  # noise is black
        second[one.rows[0] : one.rows[1]] = levels[one.labels[1]]
    first, rescued, lost = _found_by_source(drive)
    whole = f"frame {one.frame.index}: distance of each pixel to its cluster, three times as bright"
    corners = around(drive.faces.box[row], grey.shape)
    small = beside([cut(image, corners, TALL) for image in (rgb, grey, second)])
    return figure("2.3").shown(
        f"of {first + rescued + lost} labelled views of signs {first} have a region of pass one that passes the size "
        f"gate, {rescued} only one of pass two, {lost} neither: pass two finds {share_words(rescued, rescued + lost)}",
        photo(grey, whole, IMAGE_WIDE),
        photo(second, f"K-means on it, k = {k}: brighter classes are farther", IMAGE_WIDE),
        photo(small, "the sign of figure 2.2: the image, its differences, their classes"),
        claim=reached(rescued, rescued + lost, 0.5),
    )


def _found_by_source(drive: Drive) -> tuple[int, int, int]:
    """How many faces have a region on them in pass one, only in pass two, and in neither."""
    faces, first, found = drive.faces, set[int](), set[int]()
    for frame, regions in drive.regions.items():
        label, face = faces.label_regions(frame, regions.box)
        found.update(face[label == ON].tolist())
        first.update(face[(label == ON) & (regions.source == SOURCES.index("pass1"))].tolist())
    total = int((faces.example & np.isin(faces.frame, list(drive.regions))).sum())
    return len(first), len(found - first), total - len(found)


def _size_gate(drive: Drive, one: Segmentation | None) -> Iterator[Figure]:
    low, high = REPORT_GATE_PX
    if "size" not in drive.samples:
        return
    samples, gate = drive.samples["size"], drive.settings.gate
    area, count, on = samples.values[:, 0], samples.count, samples.label == ON
    edges = np.logspace(0, 6, 37)
    every, faces = (np.histogram(area[k], edges, weights=count[k])[0] for k in (on | ~on, on))
    axes = new_axes((1, 1e6), (1, 2 * max(every.max(), 1)), ("area, px", "segments"))
    axes.set(xscale="log", yscale="log")
    for values, ink, name in ((every, 0, "all segments"), (faces, 1, "on labelled signs")):
        bars = np.maximum(values, 1)
        axes.stairs(bars, edges, baseline=1, fill=True, alpha=0.6, color=INKS[ink], label=name)
    for limit in (*REPORT_GATE_PX, gate.largest_px):
        axes.axvline(limit, color=TEXT, linestyle="--", linewidth=1)
    pictures = [svg(axes, "dashed: 50 and 20000 px, and the largest area that is kept here")]
    if one is not None:
        kept = one.regions.box[one.regions.source == SOURCES.index("pass1")]
        gated = boxed(clustered(one)[1], list(kept), width=1)
        words = f"the {len(kept)} segments of pass one after the gate"
        pictures.append(photo(gated, words, IMAGE_WIDE))

    def counted(rows: NDArray[np.bool_]) -> int:
        return int(count[rows].sum())

    yield figure("3.1").shown(
        f"{count.sum():,} segments: {100 * counted(area < low) / count.sum():.1f} % below {low} px, "
        f"{counted(area > high)} above {high} px; of {counted(on)} on labelled signs the report's gate drops "
        f"{counted(on & ((area < low) | (area > high)))}, the gate here ({gate.smallest_px} to {gate.largest_px} px) "
        f"{counted(on & ((area < gate.smallest_px) | (area > gate.largest_px)))}",
        *pictures,
    )


def _crops(
    images: Images, samples: ClassifierSamples, rows: list[int], total: int
) -> tuple[Picture, ...]:
    crops = []
    for row in rows:
        rgb, box = images[int(samples.frame[row])], samples.box[row]
        corners = around(box, rgb.shape[:2], least=48)
        crops.append(cut(boxed(rgb, [box], width=1), corners, 120))
    return (photo(beside(crops, 8), f"{len(crops)} of {total} segments"),) if crops else ()


REPORT_IMAGES, REPORT_SHAPES = 50, 0.92
_TALL, _MOST = 300, 4

View = list[FaceOutline]
"""The outlines on one face in one image, by falling size."""


def shape_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 4.1 and 4.2, and the claim."""
    known = [one for one in drive.outlines if drive.faces.shape[one.face]]
    each = groupby(known, key=lambda one: (one.frame, one.face))
    views = [sorted(own, key=_area, reverse=True) for _, own in each]
    by_size = sorted(views, key=lambda view: -_area(view[0]))
    found = [view for view in by_size if right(drive, view)]
    # the largest of each shape
    shown = list({drive.faces.shape[v[0].face]: v for v in reversed(found)}.values())[:_MOST]
    worst = [view for view in by_size if not right(drive, view)][:_MOST]
    images = drive.images({view[0].frame for view in (*shown, *worst)})
    for number, those in (("4.1", shown), ("4.2", worst)):
        if those:
            outlines = [view[0] for view in those]
            yield figure(number).shown(_told(drive, outlines), _drawn(images, outlines))
    yield _claim(drive, views)


def right(drive: Drive, view: View) -> bool:
    """Whether one of its outlines is accepted with the right shape."""
    return any(one.accepted and one.named == drive.faces.shape[one.face] for one in view)


def _area(one: FaceOutline) -> float:
    return float(np.prod(one.box[2:] - one.box[:2]))


def _drawn(images: Images, outlines: Sequence[FaceOutline]) -> Picture:
    crops = []
    for one in outlines:
        rgb = images[one.frame]
        curves = {name: curve_of_terms(one.sequence[None], CURVES[name])[0] for name in CURVES}
        lines = [(v, OUTLINE_INKS[k]) for k, v in ({"traced": one.sequence} | curves).items()]
        crops.append(lined(rgb, around(one.box, rgb.shape[:2], times=1.5, least=24), _TALL, lines))
    return photo(beside(crops), "white: traced; orange: circle; blue: ellipse; pink: six terms")


def _told(drive: Drive, outlines: Sequence[FaceOutline]) -> str:
    return "; ".join(
        f"{drive.faces.shape[one.face]} taken for {one.named} at {one.distance:.1f}"
        + ("" if one.accepted else ", too far")
        for one in outlines
    )


def _claim(drive: Drive, views: Sequence[View]) -> Figure:
    sample = evenly(views, REPORT_IMAGES)
    hits = sum(right(drive, view) for view in sample)
    found = sum(any(one.accepted for one in view) for view in sample)
    return figure("4 (claim)").shown(
        f"views of labelled signs that reach the classifier, evenly along the drive: right "
        f"{share_words(hits, len(sample))}; some sign shape {share_words(found, len(sample))}. The intervals take "
        "views as independent, which those of one sign are not",
        claim=reached(hits, len(sample), REPORT_SHAPES),
    )
