"""Colour class of every candidate (report chapter 3.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from wayside.schemas.detections import COLORS, Candidates, Detections, Segmentation, verdict_code
from wayside.schemas.models import GaussianModel
from wayside.stages.classifiers import nearest_class, require_gaussian_model
from wayside.stages.imaging import SPACES, to_space


def classify_color(
    segmentations: Iterator[Segmentation], model: GaussianModel, gate: bool
) -> Iterator[Detections]:
    """Give every region the colour class of its mean colour by Mahalanobis distance (report eq. 3.1).

    The class is the nearest of those whose threshold holds; where none holds, the nearest of all, beyond its threshold.

    Parameters
    ----------
    segmentations
        Pictures with their regions.
    model
        Mean, covariance and threshold of each colour, in the space it names ("rgb" as in the report).
    gate
        Whether a region beyond every threshold gets the verdict `color` (the report's chain). Otherwise all stay open
        and class and distance are features for a later judge.

    Yields
    ------
    One item a picture, in order; all regions are candidates.

    Raises
    ------
    InputError
        If the model names a colour or a space that does not exist.
    """
    require_gaussian_model(model, COLORS, dict.fromkeys(SPACES, 3))
    for one in segmentations:
        candidates = Candidates.of(one.regions)
        values = to_space(one.regions.rgb, model.space)
        color, distance, accepted = nearest_class(values, model, COLORS)
        verdict = np.where(accepted | (not gate), candidates.verdict, verdict_code("color"))
        yield Detections(
            one,
            replace(
                candidates,
                color=color,
                color_distance=distance,
                verdict=verdict.astype(np.uint8),
            ),
        )
