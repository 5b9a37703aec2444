"""Chapters 2 to 4: segmentation by K-means in two passes, the size gate, the colour and the shape classifier."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.asked import ClassifierSamples
from wayside.pipeline.learning.labelled import OFF, ON
from wayside.pipeline.learning.page import INKS, TEXT, Figure, Picture, new_axes, svg
from wayside.pipeline.report_figures.drive import (
    Drive,
    FaceOutline,
    Scene,
    around,
    beside,
    boxed,
    cut,
    evenly,
    figure,
    lined,
    photo,
)
from wayside.pipeline.statistics import share_words
from wayside.pipeline.view.drawing import CURVES, curve_of_terms
from wayside.pipeline.view.drawing import INKS as OUTLINE_INKS
from wayside.schemas.detections import SOURCES

REPORT_GATE_PX = (50, 20_000)
TALL = 220
_MOST_CROPS = 8

Images = dict[int, NDArray[np.uint8]]


def segmentation_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 2.1 to 3.1."""
    faces = drive.faces
    rows = np.flatnonzero(faces.example & np.isin(faces.frame, list(drive.frames)))
    if not len(rows):
        for number in ("2.1", "2.2", "2.3"):
            yield figure(number).left_out("labels of a whole sign face")
        yield _size_gate(drive, None)
        return
    yellow, green = (
        rows[faces.color[rows] == color].tolist() or rows.tolist() for color in ("yellow", "green")
    )
    tall = (faces.box[:, 3] - faces.box[:, 1]).tolist()
    near, far = max(yellow, key=tall.__getitem__), min(green, key=tall.__getitem__)
    scenes = drive.scenes({int(faces.frame[row]) for row in (near, far)})
    near_scene, far_scene = (scenes[int(faces.frame[row])] for row in (near, far))
    yield _clustered(drive, "2.1", near_scene, near)
    yield _clustered(drive, "2.2", far_scene, far)
    yield _difference(drive, far_scene, far)
    yield _size_gate(drive, near_scene)


def color_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 3.2 to 3.4."""
    samples = drive.samples["color"].known()
    named = {color: samples.named == color for color in ("yellow", "green")}
    right = np.flatnonzero((samples.kind == "yellow") & named["yellow"])
    off = samples.label == OFF
    size = (samples.box[:, 2:] - samples.box[:, :2]).prod(axis=1)
    wrong = {
        color: (rows := np.flatnonzero(off & own))[np.argsort(-size[rows], kind="stable")]
        for color, own in named.items()
    }
    chosen = (
        ("3.2", "yellow", right),
        ("3.3", "green", wrong["green"]),
        ("3.4", "yellow", wrong["yellow"]),
    )
    crops = [evenly(rows.tolist(), _MOST_CROPS) for *_, rows in chosen]
    images = drive.images({int(samples.frame[row]) for own in crops for row in own})
    for (number, color, rows), own in zip(chosen, crops, strict=True):
        found, signs, false, others = rates_of(samples, color)
        ours = (
            f"at the shipped distance: TPR {share_words(found, signs)} of the segments on {color} signs, "
            f"FPR {share_words(false, others)} of the segments on no sign"
        )
        yield figure(number).shown(ours, *_crops(images, samples, own, len(rows)))


def rates_of(samples: ClassifierSamples, color: str) -> tuple[int, int, int, int]:
    """Segments on signs of a colour named so, and all; segments on no sign named so, and all (eq. 10.1, 10.2)."""
    on = (samples.label == ON) & (samples.kind == color)
    off, named = samples.label == OFF, samples.named == color
    return int((on & named).sum()), int(on.sum()), int((off & named).sum()), int(off.sum())


def _clustered(drive: Drive, number: str, scene: Scene, row: int) -> Figure:
    box = drive.faces.box[row]
    x0, y0, x1, y1 = _inside(box, scene.rgb.shape)
    own = scene.difference[y0:y1, x0:x1]
    corners = around(box, scene.rgb.shape[:2])
    pictures = beside([cut(scene.rgb, corners, TALL), cut(scene.clustered, corners, TALL)])
    pixels = scene.clustered[y0:y1, x0:x1].reshape(-1, 3)
    (color, count) = Counter(map(tuple, pixels.tolist())).most_common(1)[0]
    ours = (
        f"frame {scene.segmentation.frame.index}, {drive.faces.color[row] or 'unknown'} sign {box[2] - box[0]:.0f} x "
        f"{box[3] - box[1]:.0f} px, k = {len(scene.segmentation.palette)}: {100 * count / len(pixels):.0f} % of its "
        f"pixels are of one cluster, whose colour is {color}; its pixels lie {np.median(own):.0f} levels from the "
        f"colours of their clusters (median; whole image {np.median(scene.difference):.0f})"
    )
    return figure(number).shown(
        ours, photo(pictures, "the image, and in the colours of its clusters")
    )


def _difference(drive: Drive, scene: Scene, row: int) -> Figure:
    grey, one = np.minimum(np.rint(3 * scene.difference), 255).astype(np.uint8), scene.segmentation
    second, k = np.zeros_like(grey), len(one.difference_levels)
    if one.labels is not None:
        levels = np.linspace(-255, 255, k).clip(0).astype(np.uint8)  # noise is black
        second[one.rows[0] : one.rows[1]] = levels[one.labels[1]]
    by_source = _found_by_source(drive)
    corners = around(drive.faces.box[row], scene.rgb.shape[:2])
    counts = ", ".join(f"{count} {words}" for words, count in by_source.items())
    whole = f"frame {one.frame.index}: distance of each pixel to its cluster, three times as bright"
    small = beside([cut(image, corners, TALL) for image in (scene.rgb, grey, second)])
    return figure("2.3").shown(
        f"of {sum(by_source.values())} labelled views of signs, by the connected regions that pass the size gate: "
        f"{counts}",
        photo(grey, whole, scale=0.5),
        photo(second, f"K-means on it, k = {k}: brighter classes are farther", scale=0.5),
        photo(small, "the small sign of figure 2.2: the image, its differences, their classes"),
    )


def _found_by_source(drive: Drive) -> dict[str, int]:
    """How many faces have a region on them in pass one, in pass two alone, in none."""
    faces, counts = drive.faces, [0, 0, 0]
    for frame, regions in drive.regions.items():
        label, face = faces.label_regions(frame, regions.box)
        for row in np.flatnonzero((faces.frame == frame) & faces.example):
            sources = {SOURCES[s] for s in regions.source[(label == ON) & (face == row)]}
            counts[0 if "pass1" in sources else 1 if sources else 2] += 1
    names = ("have one from pass one", "only from pass two", "from neither")
    return dict(zip(names, counts, strict=True))


def _size_gate(drive: Drive, scene: Scene | None) -> Figure:
    low, high = REPORT_GATE_PX
    if "size" not in drive.samples:
        return figure("3.1").left_out("segments counted before the gate")
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
    if scene is not None:
        gated = _gated(scene, gate.smallest_px, gate.largest_px)
        pictures.append(photo(gated, "pass one after the gate", scale=0.5))

    def counted(rows: NDArray[np.bool_]) -> int:
        return int(count[rows].sum())

    return figure("3.1").shown(
        f"{count.sum():,} segments: {100 * counted(area < low) / count.sum():.1f} % below {low} px, "
        f"{counted(area > high)} above {high} px; of {counted(on)} on labelled signs the report's gate drops "
        f"{counted(on & ((area < low) | (area > high)))}, the gate here ({gate.smallest_px} to {gate.largest_px} px) "
        f"{counted(on & ((area < gate.smallest_px) | (area > gate.largest_px)))}",
        *pictures,
    )


def _gated(scene: Scene, smallest: int, largest: int) -> NDArray[np.uint8]:
    """The clustered image with the boxes of the regions that the gate drops in black."""
    one = scene.segmentation
    page = scene.clustered
    if one.labels is None:
        return page
    labels, top = one.labels[0], one.rows[0]
    kept = np.zeros(labels.shape, np.uint8)
    for value in range(len(one.palette)):
        _, parts, found, _ = cv2.connectedComponentsWithStats(
            (labels == value).astype(np.uint8), connectivity=4
        )
        area = found[:, cv2.CC_STAT_AREA]
        good = (area >= smallest) & (area <= largest)
        good[0] = False
        kept |= good[parts].astype(np.uint8)
    page[top : top + len(kept)][kept == 0] = 0
    return page


def _inside(box: NDArray[np.float64], shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """The middle of a box, a fifth off each side, as whole pixels of an image."""
    margin = 0.2 * (box[2:] - box[:2])
    x0, y0 = np.maximum(np.floor(box[:2] + margin), 0).astype(int)
    x1, y1 = np.ceil(box[2:] - margin).astype(int)
    return x0, y0, min(max(x1, x0 + 1), shape[1]), min(max(y1, y0 + 1), shape[0])


def _crops(
    images: Images, samples: ClassifierSamples, rows: list[int], total: int
) -> tuple[Picture, ...]:
    crops = []
    for row in rows:
        rgb, box = images[int(samples.frame[row])], samples.box[row]
        corners = around(box, rgb.shape[:2], least=48)
        crops.append(cut(boxed(rgb, [box], width=1), corners, 120))
    return (photo(beside(crops, 8), f"{len(crops)} of {total} segments"),) if crops else ()


REPORT_IMAGES = 50
_TALL, _MOST = 300, 4

View = list[FaceOutline]
"""The outlines on one face in one image."""


def shape_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 4.1 and 4.2, and the claim."""
    known = [one for one in drive.outlines if drive.faces.shape[one.face]]
    views = [list(own) for _, own in groupby(known, key=lambda one: (one.frame, one.face))]
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
) -> NDArray[np.uint8]:
    crops = []
    for one in outlines:
        rgb = images[one.frame]
        corners = around(one.box, rgb.shape[:2], times=1.5, least=24)
        lines = [(one.sequence, OUTLINE_INKS["traced"])]
        for name in curves:
            curve = curve_of_terms(one.sequence[None], CURVES[name])[0]
            lines.append((curve, OUTLINE_INKS[name]))
        crops.append(lined(rgb, corners, _TALL, lines))
    return beside(crops)


def _curves(drive: Drive, images: Images, shown: Sequence[FaceOutline]) -> Figure:
    if not shown:
        return figure("4.1").left_out("a labelled sign whose outline is recognised")
    rows = [("shape", *(name.replace("_", " ") for name in CURVES))]
    for one in shown:
        errors = [f"{100 * misfit(one.sequence, terms):.1f} %" for terms in CURVES.values()]
        rows.append((drive.faces.shape[one.face], *errors))
    words = "white: traced; orange: circle; blue: ellipse; pink: six terms"
    ours = "distance of the outline from each curve, RMS, as a share of its mean radius:"
    return figure("4.1").shown(ours, photo(_drawn(images, shown, tuple(CURVES)), words), table=rows)


def _false_negatives(drive: Drive, images: Images, worst: Sequence[FaceOutline]) -> Figure:
    if not worst:
        return figure("4.2").shown("none of the labelled signs is missed")
    told = [
        f"{drive.faces.shape[one.face]} taken for {one.named} at {one.distance:.1f}"
        + ("" if one.accepted else ", too far")
        for one in worst
    ]
    return figure("4.2").shown("; ".join(told), photo(_drawn(images, worst, ()), "traced outlines"))


def _claim(drive: Drive, views: Sequence[View]) -> Figure:
    sample = evenly(views, REPORT_IMAGES)
    hits = sum(right(drive, view) for view in sample)
    found = sum(any(one.accepted for one in view) for view in sample)
    every = sum(right(drive, view) for view in views)
    return figure("4 (claim)").shown(
        f"views of labelled signs that reach the classifier, evenly along the drive: right "
        f"{share_words(hits, len(sample))}; some sign shape {share_words(found, len(sample))}; right on all "
        f"{share_words(every, len(views))}. The intervals take views as independent, which those of one sign are not"
    )
