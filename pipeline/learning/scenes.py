"""Real images that the models that ship may be learned from, by source, and their faces as samples of classes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path

from wayside.pipeline.learning.detector_images import (
    LabelledImage,
    real_drive_images,
    scene_set_images,
)
from wayside.schemas.errors import InputError


def real_sources(
    folder: Path, without: Collection[str] = ()
) -> dict[str, Callable[[], Iterator[LabelledImage]]]:
    """The sources of a folder of real images that the models of one image are learned from, by name.

    Only what its README marks as fit for that; what is not here is for tests. A source is held out as a whole:
    `without` names those to be left out. Raises InputError where there is none of such a name.
    """
    drives = ("us_freeway_challenge", "us_freeway_white_right", "ca_city_garmin")
    sources: dict[str, Callable[[], Iterator[LabelledImage]]] = {
        name: partial(real_drive_images, folder / f"{name}.mcap") for name in drives
    }
    for prefix in ("jd", "mi"):
        read = partial(scene_set_images, folder / "scenes", (f"{prefix}_",))
        sources[f"scenes/{prefix}"] = read
    for name in ("scenes_mixed", "scenes_speed_us"):
        sources[name] = partial(scene_set_images, folder / name)
    if unknown := set(without) - sources.keys():
        raise InputError(
            f"wanted sources to leave out among {', '.join(sources)}, found {', '.join(sorted(unknown))}"
        )
    return {name: read for name, read in sources.items() if name not in without}
