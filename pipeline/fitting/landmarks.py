"""What the classifiers of landmarks are asked about when labelled logs are run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from wayside.pipeline.fitting.gaussians import Samples
from wayside.pipeline.fitting.sources import LabelledDrive, sign_of_view
from wayside.pipeline.learning.gates import OVERHEAD_M
from wayside.pipeline.learning.samples import NEITHER, ON
from wayside.pipeline.model_files import Models
from wayside.pipeline.roc.classifier_samples import ClassifierSamples
from wayside.pipeline.roc.samples import gather_samples
from wayside.schemas.errors import InputError
from wayside.schemas.labels import SIGN
from wayside.schemas.settings import Settings


def run_drives(
    drives: Iterable[LabelledDrive], settings: Settings, models: Models
) -> list[tuple[LabelledDrive, Mapping[str, ClassifierSamples]]]:
    """Run the logs among the drives: what each classifier was asked there. Raises InputError where there is none."""
    logs = [drive for drive in drives if drive.is_log]
    if not logs:
        raise InputError(
            "wanted a log, found folders of images: landmarks are seen in several images in order; "
            "make a log of them with wayside import"
        )
    return [(one, gather_samples(one.path, one.own_labels(), settings, models)) for one in logs]


def landmark_samples(
    runs: Iterable[tuple[LabelledDrive, Mapping[str, ClassifierSamples]]], classifier: str
) -> Samples:
    """The landmarks that a classifier was asked about, those of signs as class `SIGN`; no rows where none was."""
    values, kinds, signs, stretches, folds = [], [], [], [], []
    unnamed = -1
    for drive, asked in runs:
        if classifier not in asked:
            continue
        own = asked[classifier].select(asked[classifier].label != NEITHER)
        on = own.label == ON
        sign = np.array(
            [
                sign_of_view(drive, int(frame), box.tolist()) if is_on else -1
                for frame, box, is_on in zip(own.frame, own.box, on, strict=True)
            ],
            np.int64,
        )
        stretch = drive.stretch_of(own.frame.astype(np.int64), sign)
        # a landmark whose best view is in no labelled image is a sign of its own
        missing = on & (sign < 0)
        sign[missing] = unnamed - 1 - np.arange(missing.sum())
        unnamed -= int(missing.sum())
        values.append(own.values)
        kinds.append(np.where(on, SIGN, ""))
        signs.append(sign)
        stretches.append(stretch)
        folds.append(drive.fold_of(stretch))
    if not values:
        empty = np.zeros(0, np.int64)
        return Samples(np.zeros((0, 1)), np.zeros(0, np.str_), empty, empty, empty)
    return Samples(*(np.concatenate(column) for column in (values, kinds, signs, stretches, folds)))


def by_side(samples: Samples) -> Samples:
    """Places (n, 2) of signs as the classes of the location model: `right` and `left` of the path, `overhead`."""
    if not len(samples):
        return samples
    right, up = samples.values.T
    side = np.where(up > OVERHEAD_M, "overhead", np.where(right >= 0, "right", "left"))
    kind = np.where(samples.kind == "", "", side)
    return Samples(samples.values, kind, samples.sign, samples.stretch, samples.fold)
