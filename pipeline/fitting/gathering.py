"""What the classifiers of a fit are asked about: regions of labelled images, and landmarks of labelled logs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.fitting.sources import LabelledDrive
from wayside.pipeline.learning.asked import ClassifierSamples, gather_samples
from wayside.pipeline.learning.gates import OVERHEAD_M
from wayside.pipeline.learning.gaussians import Samples, sides
from wayside.pipeline.learning.samples import OFF, ON
from wayside.pipeline.models.model_files import Models
from wayside.schemas.detections import COLORS
from wayside.schemas.errors import InputError
from wayside.schemas.labels import SIGN
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import Settings
from wayside.stages.classifiers import nearest_class
from wayside.stages.report import color_features, region_descriptors
from wayside.stages.segmentation import segment

MOST_OTHERS = 100
"""Regions of an image that are no sign and are looked at: 50 images then tell a rate of 0.01 by 50 samples."""


@dataclass(frozen=True, slots=True)
class Gathered:
    """Samples of one classifier, and how many labelled faces there are and have a region on them."""

    samples: Samples
    faces: int
    met: int


def region_samples(
    drives: Sequence[LabelledDrive], settings: Settings, accepting: GaussianModel | None = None
) -> Gathered:
    """What the colour classifier is asked about; with colours that accept regions before it, the shape classifier.

    Mean colours, in RGB, of regions on labelled faces and on none; or Fourier descriptors of outlines, of those on none
    where the colours accept them. Of an image at most `MOST_OTHERS` others, evenly spread.
    """
    parts, faces, met = [], 0, 0
    for drive in drives:
        names = drive.faces.color if accepting is None else drive.faces.shape
        seen: set[int] = set()
        images = (image for image in drive.images(settings.read) if image.rgb is not None)
        for item in segment(images, settings.segment, settings.gate):
            regions = item.regions
            label, face = drive.faces.label_regions(item.frame.index, regions.box)
            kind = np.array(["" if f < 0 else names[f] for f in face], np.str_)
            off = label == OFF
            if accepting is not None:
                features = color_features(regions.rgb, accepting.space)
                off &= nearest_class(features, accepting, COLORS)[2]
            on = np.flatnonzero((label == ON) & (kind != ""))
            rows = np.union1d(spread(np.flatnonzero(off), MOST_OTHERS), on)
            values = (
                regions.rgb[rows].astype(np.float64)
                if accepting is None
                else region_descriptors(item, regions.select(rows))
            )
            known = np.isfinite(values).all(axis=1)
            rows, values = rows[known], values[known]
            sign = np.array([-1 if f < 0 else drive.faces.sign[f] for f in face[rows]], np.int64)
            frames = np.full(len(rows), item.frame.index, np.int64)
            parts.append(_samples(drive, frames, values, kind[rows], sign))
            seen.update(face[rows][face[rows] >= 0].tolist())
        faces, met = faces + int((drive.faces.example & (names != "")).sum()), met + len(seen)
    if not parts:
        raise InputError("no labelled image can be decoded. Check the images that the labels name.")
    return Gathered(Samples.joined(parts), faces, met)


def run_drives(
    drives: Iterable[LabelledDrive], settings: Settings, models: Models
) -> list[tuple[LabelledDrive, Mapping[str, ClassifierSamples]]]:
    """Run the logs among the drives: what each classifier was asked there. Raises InputError without one."""
    logs = [drive for drive in drives if drive.is_log]
    if not logs:
        raise InputError(
            "folders of images have no landmarks, which are seen in several images in order. Make a log of them with "
            "`wayside import`."
        )
    return [(one, gather_samples(one.path, one.own_labels(), settings, models)) for one in logs]


def landmark_samples(
    runs: Iterable[tuple[LabelledDrive, Mapping[str, ClassifierSamples]]], classifier: str
) -> Samples:
    """The landmarks that a classifier was asked about, those of signs as class `SIGN`; no rows where none was."""
    parts = []
    unnamed = -1
    for drive, asked in runs:
        if classifier not in asked:
            continue
        own = asked[classifier].known()
        on = own.label == ON
        sign = np.full(len(own), -1, np.int64)
        for row in np.flatnonzero(on):
            sign[row] = drive.faces.sign_at(int(own.frame[row]), own.box[row].tolist())
        part = _samples(drive, own.frame.astype(np.int64), own.values, np.where(on, SIGN, ""), sign)
        # a landmark whose best view is in no labelled image is a sign of its own
        missing = on & (sign < 0)
        sign[missing] = unnamed - 1 - np.arange(missing.sum())
        unnamed -= int(missing.sum())
        parts.append(part)
    if not parts:
        none = np.zeros(0, np.int64)
        return Samples(np.zeros((0, 1)), np.zeros(0, np.str_), none, none, none)
    return Samples.joined(parts)


def by_side(samples: Samples) -> Samples:
    """Places (n, 2) of signs as the classes of the location model: `right` and `left` of the path, `overhead`."""
    if not len(samples):
        return samples
    side = sides(samples.values, OVERHEAD_M)
    kind = np.where(samples.kind == "", "", side)
    return Samples(samples.values, kind, samples.sign, samples.stretch, samples.fold)


def spread(rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most so many of the rows, evenly spread among them."""
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def _samples(
    drive: LabelledDrive,
    frames: NDArray[np.int64],
    values: NDArray[np.float64],
    kind: NDArray[np.str_],
    sign: NDArray[np.int64],
) -> Samples:
    stretch = drive.stretch_of(frames, sign)
    return Samples(values, kind, sign, stretch, drive.fold_of(stretch))
