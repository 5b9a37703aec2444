"""Settings of the ground beside the road."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class RoadsideSettings:
    """Cross-sections of the road: height of the ground, edge of the travelled way, slopes."""

    on: bool = setting(False, "", "measure the ground and the painted lines beside the path")
