"""Colour class of every candidate (report chapter 3.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from wayside.schemas.models import GaussianModel
from wayside.schemas.regions import COLORS, Candidates, Judged, Segmented, verdict_code
from wayside.stages.numerics.classes import check_model, nearest_class
from wayside.stages.numerics.colorspace import SPACES, to_space


def classify_color(
    segmented: Iterator[Segmented], model: GaussianModel, gate: bool
) -> Iterator[Judged]:
    """Give every region the colour class of its mean colour by Mahalanobis distance (report eq. 3.1).

    The class is the nearest of those whose threshold holds; where none holds, the nearest of all, beyond its threshold.

    Parameters
    ----------
    segmented
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
    check_model(model, COLORS, dict.fromkeys(SPACES, 3))
    for one in segmented:
        candidates = Candidates.of(one.regions)
        values = to_space(one.regions.rgb, model.space)
        color, distance, accepted = nearest_class(values, model, COLORS)
        verdict = np.where(accepted | (not gate), candidates.verdict, verdict_code("color"))
        yield Judged(
            one,
            replace(
                candidates,
                color=color,
                color_distance=distance,
                verdict=verdict.astype(np.uint8),
            ),
        )
