"""What the colour and shape classifiers of preset `report` are asked about in labelled images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.fitting.gaussians import Samples
from wayside.pipeline.fitting.sources import LabelledDrive
from wayside.pipeline.learning.samples import OFF, ON
from wayside.schemas.detections import COLORS, Segmentation
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import Settings
from wayside.stages.classifiers import nearest_class
from wayside.stages.report import color_features, region_descriptors
from wayside.stages.segmentation import segment


@dataclass(frozen=True, slots=True)
class Gathered:
    """Samples of one classifier, and how many labelled faces there are and have a region on them."""

    samples: Samples
    faces: int
    met: int


def color_samples(
    drives: Sequence[LabelledDrive], settings: Settings, most_others: int
) -> Gathered:
    """Mean colours, in RGB, of the regions on labelled faces and of those on none."""
    parts, faces, met = [], 0, 0
    for drive in drives:
        wanted = drive.faces.example & np.array([c != "" for c in drive.faces.color], bool)
        seen: set[int] = set()
        for item in _segmented(drive, settings):
            label, face = drive.faces.label_regions(item.frame.index, item.regions.box)
            color = np.array(["" if f < 0 else drive.faces.color[f] for f in face])
            off = spread(np.flatnonzero(label == OFF), most_others)
            rows = np.union1d(off, np.flatnonzero((label == ON) & (color != "")))
            values = item.regions.rgb[rows].astype(np.float64)
            parts.append(_samples(drive, item, values, color[rows], face[rows]))
            seen.update(face[rows][face[rows] >= 0].tolist())
        faces, met = faces + int(wanted.sum()), met + len(seen)
    return Gathered(joined(parts), faces, met)


def shape_samples(
    drives: Sequence[LabelledDrive], settings: Settings, most_others: int, colors: GaussianModel
) -> Gathered:
    """Fourier descriptors of outlines: of regions on labelled faces, and of those off them that the colours accept."""
    parts, faces, met = [], 0, 0
    for drive in drives:
        wanted = drive.faces.example & np.array([s != "" for s in drive.faces.shape], bool)
        seen: set[int] = set()
        for item in _segmented(drive, settings):
            label, face = drive.faces.label_regions(item.frame.index, item.regions.box)
            shape = np.array(["" if f < 0 else drive.faces.shape[f] for f in face])
            features = color_features(item.regions.rgb, colors.space)
            asked = nearest_class(features, colors, COLORS)[2]
            off = spread(np.flatnonzero((label == OFF) & asked), most_others)
            rows = np.union1d(off, np.flatnonzero((label == ON) & (shape != "")))
            values = region_descriptors(item, item.regions.select(rows))
            known = np.isfinite(values).all(axis=1)
            rows, values = rows[known], values[known]
            parts.append(_samples(drive, item, values, shape[rows], face[rows]))
            seen.update(face[rows][face[rows] >= 0].tolist())
        faces, met = faces + int(wanted.sum()), met + len(seen)
    return Gathered(joined(parts), faces, met)


def joined(parts: Iterable[Samples]) -> Samples:
    """The rows of several, in that order; raises InputError of none."""
    listed = list(parts)
    if not listed:
        raise InputError(
            "wanted a labelled image that decodes, found none; check the images that the labels name"
        )
    return Samples(
        np.concatenate([part.values for part in listed]),
        np.concatenate([part.kind for part in listed]),
        np.concatenate([part.sign for part in listed]),
        np.concatenate([part.stretch for part in listed]),
        np.concatenate([part.fold for part in listed]),
    )


def spread(rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most so many of the rows, evenly spread among them."""
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def _segmented(drive: LabelledDrive, settings: Settings) -> Iterator[Segmentation]:
    images = (image for image in drive.images(settings.read) if image.rgb is not None)
    return segment(images, settings.segment, settings.gate)


def _samples(
    drive: LabelledDrive,
    item: Segmentation,
    values: NDArray[np.float64],
    kind: NDArray[np.str_],
    face: NDArray[np.int64],
) -> Samples:
    sign = np.full(len(face), -1, np.int64)
    sign[face >= 0] = drive.sign[face[face >= 0]]
    stretch = drive.stretch_of(np.full(len(face), item.frame.index, np.int64), sign)
    return Samples(values, kind.astype(np.str_), sign, stretch, drive.fold_of(stretch))
