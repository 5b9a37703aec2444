"""Settings of what only the report's chain has: its gates (chapters 4 and 5)."""

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class ReportSettings:
    """The report's own chain, and the gates that it built and replaced; its last one is `locate.gate`."""

    on: bool = setting(False, "", "use the chain of the report; its presets switch it on")
    shape: bool = setting(
        False, "", "reject outlines of no known shape, after the colour gate (chapter 4)"
    )
    trajectory: str = setting(
        "off",
        "",
        "reject tracks that do not move like signs (chapter 5): image: by u, v, du, dv as in the report; compensated: "
        "with the rotation of the camera removed",
        choices=("off", "image", "compensated"),
    )
