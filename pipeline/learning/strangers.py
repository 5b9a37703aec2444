"""Models for drives that they have not seen: what they say there is what they will say of a new drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from wayside.schemas.models import ConvolutionModel, NetworkModel, TreeModel

Taught = TypeVar("Taught")
Fitted = TypeVar("Fitted", TreeModel, NetworkModel, ConvolutionModel)


def for_strangers(
    names: Sequence[str], taught: Sequence[Taught], fit: Callable[[Sequence[Taught]], Fitted]
) -> tuple[Fitted, dict[str, Fitted]]:
    """The model fitted to all that is taught, and for each drive, by its name, one fitted to the other group.

    A drive alone is judged by its own: there is no other.
    """
    models: dict[str, Fitted] = {}
    for group in (0, 1):
        own = names[group::2]
        others = taught[1 - group :: 2] or taught[group::2]
        if own:
            models |= dict.fromkeys(own, fit(others))
    return fit(taught), models
