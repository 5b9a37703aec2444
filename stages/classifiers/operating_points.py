"""Thresholds of models for a false-alarm rate (report chapter 9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

from wayside.schemas.models import EvidenceModel, GaussianModel, MixtureModel, OperatingPoint

Gate = TypeVar("Gate", bound=GaussianModel | MixtureModel | EvidenceModel)


def most_powerful(curve: Sequence[OperatingPoint], alpha: float) -> OperatingPoint:
    """The operating point of the most power among those of at most this false-alarm rate.

    Raises
    ------
    ValueError
        There is none.
    """
    allowed = [one for one in curve if one.false_alarm <= alpha]
    if not allowed:
        rates = ", ".join(f"{one.false_alarm:g}" for one in curve) or "none"
        raise ValueError(
            f"no operating point has a false-alarm rate of at most {alpha:g}; the rates are {rates}"
        )
    return max(allowed, key=lambda one: one.power)


def at_alpha(model: Gate, alpha: float) -> Gate:
    """The model with the thresholds of its most powerful operating point of at most this false-alarm rate.

    A model of evidence decides there, and its range of uncertain log odds stays as wide.

    Raises
    ------
    ValueError
        The model has no such operating point.
    """
    point = most_powerful(model.curve, alpha)
    rule = f"alpha {alpha:g}: most true positives of at most this false positive rate (report chapter 9)"
    chosen: list[dict[str, Any]] = [
        {"threshold": threshold, "threshold_rule": rule, "threshold_interval": interval}
        for threshold, interval in zip(
            point.thresholds, point.intervals or (None,) * len(point.thresholds), strict=True
        )
    ]
    if isinstance(model, GaussianModel):
        pairs = zip(model.classes, chosen, strict=True)
        return replace(model, classes=tuple(replace(one, **new) for one, new in pairs))
    (new,) = chosen
    if isinstance(model, EvidenceModel):
        decision = new["threshold"]
        new |= {
            "decision": decision,
            "threshold": model.threshold + decision - model.decision,
        }
    return replace(model, **new)
