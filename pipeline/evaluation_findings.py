"""What an evaluation finds, one by one: matches, false rows, duplicates, missed panels and why, counts by kind."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class FalseSign:
    """A reported panel that is none, with the known object it lies on; `position` is right, down, ahead in metres."""

    sign_id: str
    best_frame: int
    best_box: tuple[float, ...]
    color: str | None
    shape: str | None
    position: tuple[float, float, float] | None
    cause: str

    def to_json(self) -> dict[str, Any]:
        """As columns of `signs.parquet`, with the cause."""
        values = asdict(self)
        position, cause = values.pop("position"), values.pop("cause")
        if position is not None:
            values |= dict(zip(("right_m", "down_m", "ahead_m"), position, strict=True))
        return values | {"best_box": list(self.best_box), "cause": cause}


@dataclass(frozen=True, slots=True)
class Duplicate:
    """A reported row on a panel of the truth that a better row is on: `better` is that row, `panel` the true one."""

    sign_id: str
    panel: int | str
    better: str


@dataclass(frozen=True, slots=True)
class MissCause:
    """Why a wanted sign was not found.

    step: where it was lost (see `evaluate_misses.STEPS`); reason: verdict or status there; views: how many of its views
    came to each verdict; row: the reported row on it, if there is one, and distance_m: how far from it that row stands.
    """

    id: int | str
    step: str
    reason: str
    views: dict[str, int]
    row: str | None = None
    distance_m: float | None = None


@dataclass(frozen=True, slots=True)
class KindCount:
    """Wanted signs of one kind, and how many of them were found."""

    kind: str
    wanted: int
    found: int


@dataclass(frozen=True, slots=True)
class MissedPanel:
    """A true panel that should have been found; fields of the truth file."""

    id: int
    kind: str | None
    color: str | None
    shape: str | None
    width_m: float | None
    height_m: float | None
    lateral_m: float | None
    station_m: float | None


@dataclass(frozen=True, slots=True)
class Match:
    """A reported panel and the wanted true one it was matched with.

    `error_m`: reported minus true position: lateral, up, along, in the camera frame of `best_frame`; `sigma_m`: its
    stated standard deviations; the rest are pairs, reported then true. None where not reported.
    """

    sign_id: str
    panel_id: int
    error_m: tuple[float, float, float]
    sigma_m: tuple[float | None, float | None, float | None]
    width_m: tuple[float | None, float]
    height_m: tuple[float | None, float]
    bottom_m: tuple[float | None, float]
    color: tuple[str | None, str]
    shape: tuple[str | None, str]


@dataclass(frozen=True, slots=True)
class Backs:
    """Rows of status `back`: how many there are, and how many of them are on a panel seen from behind.

    `in_view`: panels seen from behind, as tall and in as many images as a front that should be found, but however
    much stands before them: of backs nobody knows.
    """

    reported: int = 0
    right: int = 0
    in_view: int = 0
