"""Classification by location (report chapters 8 and 11): right of the path, above the camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import LocateSettings
from wayside.stages.mapping.verdicts import location_verdict


def classify_location(
    tracked: Iterator[TrackedFrame], model: GaussianModel | None, settings: LocateSettings
) -> Iterator[TrackedFrame]:
    """Refuse landmarks where no sign stands (`location`) or of no sign's size (`panel_size`).

    The report's classifier is one mean at 3.1 m right of and .6 m above the camera's path, with a threshold on the
    Mahalanobis distance (eq. 3.1). Where the evidence for landmarks contains their place, no model refuses them again.

    Parameters
    ----------
    tracked
        Frames with the landmarks seen first in them.
    model
        Classes in (right of the path, above the camera's path), metres; None: only sizes are refused.
    settings
        Plausible sizes of a panel.

    Raises
    ------
    ValueError
        Where the model is not of that space.
    """
    if model is not None and model.space != "right_up_m":
        raise ValueError(f"a location model of space {model.space} instead of right_up_m")
    for frame in tracked:
        landmarks = (
            replace(one, verdict=location_verdict(one, model, settings))
            if one.verdict == "sign"
            else one
            for one in frame.landmarks
        )
        yield replace(frame, landmarks=tuple(landmarks))
