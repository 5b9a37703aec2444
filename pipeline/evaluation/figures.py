"""How a result compares with the truth: what was found one by one, the figures, and their JSON form."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from wayside.pipeline.evaluation.reliability import ConfidenceBin, bins_together
from wayside.pipeline.statistics import (
    Interval,
    SigmaShare,
    Spread,
    confusion,
    fraction,
    rate_interval,
    share_interval,
    sigma_share,
    spread,
)

Row = Mapping[str, Any]
AXES = ("lateral", "up", "along")
_COMMON = (
    *("wanted", "found_count", "recall", "recall_interval", "precision", "precision_interval"),
    *("images", "false_per_100_images", "false_per_100_images_interval"),
)


@dataclass(frozen=True, slots=True)
class FalseSign:
    """A reported panel that does not exist: the known object it lies on, position right, down, ahead (m)."""

    sign_id: str
    best_frame: int
    best_box: tuple[float, ...]
    color: str | None
    shape: str | None
    position: tuple[float, float, float] | None
    cause: str

    @staticmethod
    def of(sign: Row, cause: str, position: tuple[float, float, float] | None = None) -> FalseSign:
        """A row of `signs.parquet` as one."""
        box, color, shape = tuple(sign["best_box"]), sign["color"], sign["shape"]
        return FalseSign(sign["sign_id"], sign["best_frame"], box, color, shape, position, cause)

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

    `step`: where it was lost (see `misses.STEPS`). `reason`: verdict or status there. `views`: how many of its views
    came to each verdict. `row`: the reported row on it, if there is one, and distance_m: how far from it that row
    stands.
    """

    id: int | str
    step: str
    reason: str
    views: dict[str, int]
    row: str | None = None
    distance_m: float | None = None


@dataclass(frozen=True, slots=True)
class KindCount:
    """Signs of one kind that should be found, and how many were found."""

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

    `error_m`: reported minus true position: lateral, up, along, in the camera frame of `best_frame`. `sigma_m`: its
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


class _Shares(ABC):
    """What every evaluation counts, as shares with their intervals."""

    __slots__ = ()
    wanted: int
    false: tuple[FalseSign, ...]
    duplicates: tuple[Duplicate, ...]
    causes: tuple[MissCause, ...]
    images: int | None
    learned_by: tuple[str, ...] | None
    reliability: tuple[ConfidenceBin, ...]

    @property
    @abstractmethod
    def right(self) -> int:
        """Reported rows that count as right in the precision."""

    @property
    def found_count(self) -> int:
        """How many signs were found of those that should be."""
        return self.right

    @property
    def recall(self) -> float:
        """Fraction of the wanted signs that were found; 1 where none was wanted."""
        return self.found_count / self.wanted if self.wanted else 1.0

    @property
    def recall_interval(self) -> Interval | None:
        """95 % interval of the recall; None where nothing was wanted."""
        return share_interval(self.found_count, self.wanted)

    @property
    def counted(self) -> int:
        """Reported rows that the precision is a share of."""
        return self.right + len(self.false)

    @property
    def precision(self) -> float:
        """Fraction of the reported rows that are right; 1 where none counts."""
        return self.right / self.counted if self.counted else 1.0

    @property
    def precision_interval(self) -> Interval | None:
        """95 % interval of the precision; None where no row counts."""
        return share_interval(self.right, self.counted)

    @property
    def others(self) -> tuple[FalseSign, ...]:
        """False rows that are no duplicates."""
        twice = {duplicate.sign_id for duplicate in self.duplicates}
        return tuple(sign for sign in self.false if sign.sign_id not in twice)

    @property
    def false_per_100_images(self) -> float | None:
        """False rows per 100 images; None where the images are not known."""
        return 100 * len(self.false) / self.images if self.images else None

    @property
    def false_per_100_images_interval(self) -> Interval | None:
        """95 % interval of that rate."""
        return rate_interval(len(self.false), (self.images or 0) / 100)

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys; intervals are [low, high] at 95 %, null where nothing was counted."""
        figures = {name: getattr(self, name) for name in _COMMON}
        figures["learned_by"] = None if self.learned_by is None else list(self.learned_by)
        figures["false"] = [sign.to_json() for sign in self.false]
        for name in ("duplicates", "causes", "reliability"):
            figures[name] = [asdict(one) for one in getattr(self, name)]
        return figures


@dataclass(frozen=True, slots=True)
class RenderedEvaluation(_Shares):
    """Figures of a rendered drive, whose truth is exact; errors are absolute, of wanted panels that were found.

    `false` are all rows that no panel was matched with, duplicates among them. Panels that need not be found count in
    the precision as neither. `images`: read by the run, None where not known. `learned_by`: models of the run that were
    learned from this drive, None where not known. `causes`: of the missed, in their order. `reliability`: of the
    confidence of rows that are reported, uncertain ones among them.
    """

    wanted: int
    matches: tuple[Match, ...]
    false: tuple[FalseSign, ...]
    missed: tuple[MissedPanel, ...]
    backs: Backs = field(default_factory=Backs)
    duplicates: tuple[Duplicate, ...] = ()
    causes: tuple[MissCause, ...] = ()
    images: int | None = None
    learned_by: tuple[str, ...] | None = None
    reliability: tuple[ConfidenceBin, ...] = ()

    @property
    def right(self) -> int:
        """Rows matched with a wanted panel."""
        return len(self.matches)

    @property
    def found(self) -> tuple[tuple[str, int], ...]:
        """Pairs of reported sign and true panel."""
        return tuple((m.sign_id, m.panel_id) for m in self.matches)

    @property
    def error_m(self) -> dict[str, Spread]:
        """Position error by axis, and its length."""
        errors = np.array([m.error_m for m in self.matches], np.float64).reshape(-1, 3)
        by_axis = {name: spread(np.abs(errors[:, i])) for i, name in enumerate(AXES)}
        return by_axis | {"total": spread(np.linalg.norm(errors, axis=1))}

    @property
    def sigma_share(self) -> dict[str, SigmaShare]:
        """How often the stated standard deviations hold, by axis."""
        return {
            name: sigma_share(
                [m.error_m[i] for m in self.matches], [m.sigma_m[i] for m in self.matches]
            )
            for i, name in enumerate(AXES)
        }

    @property
    def width_error(self) -> Spread:
        """Error of the width as a fraction of the true one."""
        return spread(abs(a - b) / b for a, b in self._pairs("width_m"))

    @property
    def height_error(self) -> Spread:
        """Error of the height as a fraction of the true one."""
        return spread(abs(a - b) / b for a, b in self._pairs("height_m"))

    @property
    def bottom_error_m(self) -> Spread:
        """Error of the lower edge above the road."""
        return spread(abs(a - b) for a, b in self._pairs("bottom_m"))

    @property
    def color_right(self) -> float | None:
        """Fraction of the colours that are right."""
        return fraction([a == b for a, b in (m.color for m in self.matches)])

    @property
    def shape_right(self) -> float | None:
        """Fraction of the shapes that are right."""
        return fraction([a == b for a, b in (m.shape for m in self.matches)])

    @property
    def color_confusion(self) -> dict[str, int]:
        """Counts by `true -> reported`."""
        return confusion(m.color[::-1] for m in self.matches)

    @property
    def shape_confusion(self) -> dict[str, int]:
        """Counts by `true -> reported`."""
        return confusion(m.shape[::-1] for m in self.matches)

    def _pairs(self, name: str) -> list[tuple[float, float]]:
        """Reported and true lengths of the matches whose reported one is known."""
        pairs = (getattr(match, name) for match in self.matches)
        return [(a, b) for a, b in pairs if a is not None]

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys."""
        return _Shares.to_json(self) | {
            "missed": [asdict(panel) for panel in self.missed],
            "error_m": {name: asdict(value) for name, value in self.error_m.items()},
            "width_error": asdict(self.width_error),
            "height_error": asdict(self.height_error),
            "bottom_error_m": asdict(self.bottom_error_m),
            "sigma_share": {name: value.to_json() for name, value in self.sigma_share.items()},
            "color_right": self.color_right,
            "shape_right": self.shape_right,
            "color_confusion": self.color_confusion,
            "shape_confusion": self.shape_confusion,
            "found": [list(pair) for pair in self.found],
            "backs": asdict(self.backs),
        }


@dataclass(frozen=True, slots=True)
class RealEvaluation(_Shares):
    """Figures of a real drive with hand-made boxes.

    The labels are not complete: `precision` is a lower bound, and every false sign is worth a look. `touching` counts
    reported signs that lie on a label, wanted or not; `duplicates` are among them, not among the false ones. `kinds`:
    the wanted by what the labels say they are, where they do. The rest as in `RenderedEvaluation`.
    """

    wanted: int
    found: tuple[str, ...]
    touching: int
    false: tuple[FalseSign, ...]
    missed: tuple[str, ...]
    duplicates: tuple[Duplicate, ...] = ()
    kinds: tuple[KindCount, ...] = ()
    causes: tuple[MissCause, ...] = ()
    images: int | None = None
    learned_by: tuple[str, ...] | None = None
    reliability: tuple[ConfidenceBin, ...] = ()

    @property
    def found_count(self) -> int:
        """How many labels were found of those that should be."""
        return len(self.found)

    @property
    def right(self) -> int:
        """Rows that lie on a label."""
        return self.touching

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys."""
        return _Shares.to_json(self) | {
            "missed": list(self.missed),
            "found": list(self.found),
            "touching": self.touching,
            "kinds": [
                asdict(kind) | {"recall_interval": share_interval(kind.found, kind.wanted)}
                for kind in self.kinds
            ],
        }


Evaluation = RenderedEvaluation | RealEvaluation
_Kind = TypeVar("_Kind", RenderedEvaluation, RealEvaluation)


def together(evaluations: Iterable[_Kind]) -> _Kind:
    """Several drives evaluated as one, by their counts; labels are not renamed. Of none: nothing wanted or found."""
    all_of: list[Any] = list(evaluations) or [RenderedEvaluation(0, (), (), ())]
    joined = {name: _sum(name, [getattr(e, name) for e in all_of]) for name in _names(all_of[0])}
    result: _Kind = replace(all_of[0], **joined)
    return result


def _names(instance: Any) -> list[str]:
    return [one.name for one in fields(instance)]


def _sum(name: str, values: list[Any]) -> Any:
    """One field of several drives as that of all."""
    if name == "reliability":
        return bins_together(values)
    if name == "learned_by" or (name == "images" and None in values):
        return None
    if name == "backs":
        return Backs(*(sum(getattr(v, one) for v in values) for one in _names(values[0])))
    if name == "kinds":
        every = [kind for kinds in values for kind in kinds]
        counts = {k.kind: [o for o in every if o.kind == k.kind] for k in every}
        return tuple(
            KindCount(kind, sum(o.wanted for o in some), sum(o.found for o in some))
            for kind, some in counts.items()
        )
    return sum(values) if isinstance(values[0], int) else tuple(chain(*values))
