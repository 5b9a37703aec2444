"""Chapters 2 and 3: segmentation by K-means in two passes, the size gate, the colour classifier."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.asked import ClassifierSamples
from wayside.pipeline.learning.page import Figure
from wayside.pipeline.learning.plots import INKS, TEXT, new_axes, svg
from wayside.pipeline.learning.samples import OFF, ON
from wayside.pipeline.report_figures.drawing import around, beside, boxed, cut, grey_of, photo
from wayside.pipeline.report_figures.gather import Drive, Scene
from wayside.pipeline.statistics import share_words
from wayside.schemas.detections import SOURCES

REPORT_GATE_PX = (50, 20_000)
TALL = 220
_MOST_CROPS = 8


def segmentation_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 2.1 to 3.1."""
    near = _face(drive, "yellow", largest=True)
    far = _face(drive, "green", largest=False)
    frames = {int(drive.faces.frame[row]) for row in (near, far) if row is not None}
    scenes = drive.scenes(frames)
    large = "keeps its own cluster"
    yield _clustered(drive, scenes, near, "2.1", f"a large sign {large}", f"a yellow sign {large}")
    yield _clustered(
        drive,
        scenes,
        far,
        "2.2",
        "a small sign is lost",
        "a small green sign is lost in vegetation",
    )
    yield _difference(drive, scenes, far)
    yield _size_gate(drive, scenes, near)


def color_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 3.2 to 3.4."""
    samples = drive.samples["color"].known()
    images = drive.images(_crop_frames(samples))
    said = "the classifier of yellow signs is near perfect on 25 images"
    rows = np.flatnonzero((samples.kind == "yellow") & (samples.named == "yellow"))
    yield _accepted(images, samples, rows, "3.2", "yellow signs by mean colour", said, "yellow")
    rows = _wrongly(samples, "green")
    said = "segments that look like green signs are taken for them"
    yield _accepted(images, samples, rows, "3.3", "what is taken for a green sign", said, "green")
    rows = _wrongly(samples, "yellow")
    said = "road stripes are taken for yellow signs"
    yield _accepted(images, samples, rows, "3.4", "what is taken for a yellow sign", said, "yellow")


def rates_of(samples: ClassifierSamples, color: str) -> tuple[int, int, int, int]:
    """Segments on signs of a colour named so, and all; segments on no sign named so, and all (eq. 10.1, 10.2)."""
    on = (samples.label == ON) & (samples.kind == color)
    off, named = samples.label == OFF, samples.named == color
    return int((on & named).sum()), int(on.sum()), int((off & named).sum()), int(off.sum())


def _face(drive: Drive, color: str, *, largest: bool) -> int | None:
    """Row of the largest or smallest face of a colour; of any colour where there is none of it; None without faces."""
    faces = drive.faces
    rows = np.flatnonzero(faces.example & np.isin(faces.frame, list(drive.frames)))
    own = [row for row in rows if faces.color[row] == color] or rows.tolist()
    if not own:
        return None
    tall = faces.box[own, 3] - faces.box[own, 1]
    return int(own[int(np.argmax(tall) if largest else np.argmin(tall))])


def _clustered(
    drive: Drive, scenes: dict[int, Scene], row: int | None, number: str, title: str, report: str
) -> Figure:
    if row is None or int(drive.faces.frame[row]) not in scenes:
        return Figure(number, title, report, needs="labels of a whole sign face")
    scene, box = scenes[int(drive.faces.frame[row])], drive.faces.box[row]
    x0, y0, x1, y1 = _inside(box, scene.rgb.shape)
    own = scene.difference[y0:y1, x0:x1]
    corners = around(box, scene.rgb.shape[:2])
    pictures = beside([cut(scene.rgb, corners, TALL), cut(scene.clustered, corners, TALL)])
    colors, counts = np.unique(
        scene.clustered[y0:y1, x0:x1].reshape(-1, 3), axis=0, return_counts=True
    )
    first = colors[counts.argmax()]
    shown = drive.faces.color[row] or "unknown"
    return Figure(
        number,
        title,
        f"{report} (k = 16)",
        f"frame {scene.frame}, {shown} sign {box[2] - box[0]:.0f} x {box[3] - box[1]:.0f} px, "
        f"k = {len(scene.segmentation.palette)}: {100 * counts.max() / counts.sum():.0f} % of its pixels are of one "
        f"cluster, whose colour is ({first[0]}, {first[1]}, {first[2]}); its pixels lie {np.median(own):.0f} levels "
        f"from the colours of their clusters (median; whole image {np.median(scene.difference):.0f})",
        (photo(pictures, "the image, and in the colours of its clusters"),),
    )


def _difference(drive: Drive, scenes: dict[int, Scene], row: int | None) -> Figure:
    title, report = (
        "difference image and second pass",
        "small objects stand out in the difference image",
    )
    if row is None or int(drive.faces.frame[row]) not in scenes:
        return Figure("2.3", title, report, needs="labels of a whole sign face")
    scene, box = scenes[int(drive.faces.frame[row])], drive.faces.box[row]
    grey = grey_of(3 * scene.difference)
    by_source = _found_by_source(drive)
    total = sum(by_source.values())
    corners = around(box, scene.rgb.shape[:2])
    words = ", ".join(f"{count} {words}" for words, count in by_source.items())
    return Figure(
        "2.3",
        title,
        report,
        f"of {total} labelled views of signs, by the connected regions that pass the size gate: {words}",
        (
            photo(
                grey,
                f"frame {scene.frame}: distance of each pixel to its cluster, three times as bright",
                scale=0.5,
            ),
            photo(cut(grey, corners, TALL), "the small sign of figure 2.2 in it"),
        ),
    )


def _found_by_source(drive: Drive) -> dict[str, int]:
    """How many faces have a region on them in pass one, in pass two alone, in none."""
    faces, counts = drive.faces, [0, 0, 0]
    for frame, regions in drive.regions.items():
        own = np.flatnonzero((faces.frame == frame) & faces.example)
        label, face = faces.label_regions(frame, regions.box)
        for row in own:
            sources = {SOURCES[s] for s in regions.source[(label == ON) & (face == row)]}
            counts[0 if "pass1" in sources else 1 if sources else 2] += 1
    names = ("have one from pass one", "only from pass two", "from neither")
    return dict(zip(names, counts, strict=True))


def _size_gate(drive: Drive, scenes: dict[int, Scene], row: int | None) -> Figure:
    low, high = REPORT_GATE_PX
    title = "the size gate"
    report = f"segments of less than {low} px or more than {high} px are dropped"
    if "size" not in drive.samples:
        return Figure("3.1", title, report, needs="segments counted before the gate")
    samples, gate = drive.samples["size"], drive.settings.gate
    area, count = samples.values[:, 0], samples.count
    on = samples.label == ON
    edges = np.logspace(0, 6, 37)
    every, _ = np.histogram(area, edges, weights=count)
    faces, _ = np.histogram(area[on], edges, weights=count[on])
    axes = new_axes((1, 1e6), (1, 2 * max(every.max(), 1)), ("area, px", "segments"))
    axes.set(xscale="log", yscale="log")
    for values, ink, name in (
        (every, INKS[0], "all segments"),
        (faces, INKS[1], "on labelled signs"),
    ):
        axes.stairs(
            np.maximum(values, 1), edges, baseline=1, fill=True, alpha=0.6, color=ink, label=name
        )
    for limit in (*REPORT_GATE_PX, gate.largest_px):
        axes.axvline(limit, color=TEXT, linestyle="--", linewidth=1)
    total, on_total = int(count.sum()), int(count[on].sum())
    small, large = (int(count[rows].sum()) for rows in (area < low, area > high))
    lost = int(count[on & ((area < low) | (area > high))].sum())
    own = int(count[on & ((area < gate.smallest_px) | (area > gate.largest_px))].sum())
    pictures = [svg(axes, "dashed: 50 and 20000 px, and the largest area that is kept here")]
    if row is not None and int(drive.faces.frame[row]) in scenes:
        scene = scenes[int(drive.faces.frame[row])]
        pictures.append(
            photo(
                _gated(scene, gate.smallest_px, gate.largest_px),
                "pass one after the gate",
                scale=0.5,
            )
        )
    return Figure(
        "3.1",
        title,
        report,
        f"{total:,} segments: {100 * small / total:.1f} % below {low} px, {large} above {high} px; of {on_total} on "
        f"labelled signs the report's gate drops {lost}, "
        f"the gate here ({gate.smallest_px} to {gate.largest_px} px) {own}",
        tuple(pictures),
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


def _wrongly(samples: ClassifierSamples, color: str) -> NDArray[np.int64]:
    """Rows of segments on no sign that are named a colour, largest first."""
    rows = np.flatnonzero((samples.label == OFF) & (samples.named == color))
    size = (samples.box[rows, 2:] - samples.box[rows, :2]).prod(axis=1)
    return np.asarray(rows[np.argsort(-size, kind="stable")])


def _chosen(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Some of them, evenly."""
    at = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_CROPS)).round().astype(int))
    return rows[at] if len(rows) else rows


def _crop_frames(samples: ClassifierSamples) -> set[int]:
    right = np.flatnonzero((samples.kind == "yellow") & (samples.named == "yellow"))
    rows = [_chosen(r) for r in (right, _wrongly(samples, "green"), _wrongly(samples, "yellow"))]
    return {int(samples.frame[row]) for group in rows for row in group}


def _accepted(
    images: dict[int, NDArray[np.uint8]],
    samples: ClassifierSamples,
    rows: NDArray[np.int64],
    number: str,
    title: str,
    report: str,
    color: str,
) -> Figure:
    found, signs, false, others = rates_of(samples, color)
    crops = []
    for row in _chosen(rows):
        rgb, box = images.get(int(samples.frame[row])), samples.box[row]
        if rgb is not None:
            corners = around(box, rgb.shape[:2], least=48)
            crops.append(cut(boxed(rgb, [box], width=1), corners, 120))
    pictures = (photo(beside(crops, 8), f"{len(crops)} of {len(rows)} segments"),) if crops else ()
    return Figure(
        number,
        title,
        report,
        f"at the shipped distance: TPR {share_words(found, signs)} of the segments on {color} signs, "
        f"FPR {share_words(false, others)} of the segments on no sign",
        pictures,
    )
