"""Classification by location (report chapters 8 and 11): signs stand where signs stand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import LocateSettings
from wayside.stages.mapping.revision import Revision


def classify_location(
    settled: Iterator[TrackedFrame], model: GaussianModel, settings: LocateSettings
) -> Iterator[TrackedFrame]:
    """Refuse places that lie where no sign stands (`location`) or are of no sign's size (`panel_size`).

    The report's classifier is one mean at 3.1 m right of and .6 m above the camera's path, with a threshold on the
    Mahalanobis distance (eq. 3.1); a model with several classes is a mixture: near one of them is enough. Roads are
    wider and signs stand farther off than on any drive that was learned from, so a place beyond all thresholds is not
    refused if it is surely a sign (`settings.beyond`): roads differ by more than a Gaussian allows, and a place four to
    five sigmas off loses .8 of its log odds a sigma by Student's t of three degrees of freedom. Backs are those of the
    other carriageway, of which the model knows nothing: they may stand anywhere.

    Parameters
    ----------
    settled
        Frames with the places seen first in them.
    model
        Classes in (right of the path, above the camera's path), metres.
    settings
        Plausible sizes of a panel.

    Raises
    ------
    ValueError
        Where the model is not of that space.
    """
    if model.space != "right_up_m":
        raise ValueError(f"wanted a location model of space right_up_m, found {model.space}")
    revision = Revision()
    for item in settled:
        places = [replace(p, verdict=_verdict(p, model, settings)) for p in item.places]
        yield revision.apply(item, places)


def _verdict(place: Landmark, model: GaussianModel, settings: LocateSettings) -> str:
    if place.verdict != "sign":
        return place.verdict
    thresholds = np.array([c.threshold for c in model.classes])
    beyond = float((model.distances(place.offset[None, :2])[0] - thresholds).min())
    if not place.back and beyond > 0 and not place.score > settings.beyond * beyond:
        return "location"
    sides = (place.width_m, place.height_m)
    if min(sides) < settings.smallest_side_m or max(sides) > settings.largest_side_m:
        return "panel_size"
    return "sign"
