"""The gates of a run at a stated false-alarm rate: `--alpha`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from wayside.schemas.errors import InputError
from wayside.schemas.models import EvidenceModel, GaussianModel, MixtureModel
from wayside.schemas.settings import Settings
from wayside.stages.classifiers import at_alpha

if TYPE_CHECKING:
    from wayside.pipeline.models.model_files import Models


def retraded(models: Models, settings: Settings) -> Models:
    """The models with every gate of the run at a false-alarm rate; InputError where one has no such operating point."""
    lacking: list[str] = []
    traded: dict[str, Any] = {}
    for name, column in _gates(models, settings).items():
        gate: GaussianModel | MixtureModel | EvidenceModel = getattr(models, column)
        try:
            traded[column] = at_alpha(gate, settings.models.alpha)
        except ValueError as error:
            lacking.append(f"{name}: {error}")
    if lacking or not traded:
        raise InputError(
            "models.alpha: not every gate of the run has a threshold for this false-alarm rate: "
            f"{'; '.join(lacking) or 'there is no gate, because a detector of another kind decides'}. Take a larger "
            "rate, learn these models again, or leave the rate out."
        )
    return replace(models, **traded)


def _gates(models: Models, settings: Settings) -> dict[str, str]:
    """The models that decide in a run of these settings what is a sign: their fields, by the name of their file."""
    by_report = settings.report.on
    by_evidence = not by_report and models.external is None
    decides = {
        "color": ("color_classes", True),
        "shape": ("shape_classes", True),
        "trajectory": ("trajectory_density", True),
        "location": ("location_classes", by_report and settings.locate.gate),
        "place": ("landmark_classifier", by_evidence),
        "back_place": (
            "back_landmark_classifier",
            by_evidence and models.back_scores is not None,
        ),
    }
    return {
        name: field
        for name, (field, on) in decides.items()
        if on and getattr(models, field) is not None
    }
