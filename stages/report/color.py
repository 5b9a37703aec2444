"""Colour class of every candidate (report chapter 3.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from wayside.schemas.detections import COLORS, Candidates, Detections, Segmentation, verdict_code
from wayside.schemas.models import GaussianModel
from wayside.stages.classifiers import nearest_class, require_gaussian_model
from wayside.stages.report.color_space import COLOR_SPACES, color_features


def classify_color(
    segmentations: Iterator[Segmentation], *, model: GaussianModel
) -> Iterator[Detections]:
    """Give every region the colour class of its mean colour by Mahalanobis distance (report eq. 3.1).

    The class is the nearest of those whose threshold holds; where none holds, the nearest of all, and the verdict is
    `color`.

    Parameters
    ----------
    segmentations
        Images with their regions.
    model
        Mean, covariance and threshold of each colour, in space "rgb" (as in the report) or another of `COLOR_SPACES`.

    Yields
    ------
    One item an image, in order; all regions are candidates.

    Raises
    ------
    InputError
        If the model names a colour or a space that does not exist.
    """
    require_gaussian_model(model, COLORS, COLOR_SPACES)
    for one in segmentations:
        candidates = Candidates.of(one.regions)
        color, distance, accepted = nearest_class(
            color_features(one.regions.rgb, model.space), model, COLORS
        )
        verdict = np.where(accepted, candidates.verdict, verdict_code("color"))
        yield Detections(
            one,
            replace(
                candidates,
                color=color,
                color_distance=distance,
                verdict=verdict.astype(np.uint8),
            ),
        )
