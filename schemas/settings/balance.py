"""Settings of the white balance."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class BalanceSettings:
    """White balance by the road, whose asphalt is grey."""

    on: bool = setting(True, "", "take the colour that the road has in an image from all of it")
