"""The figures of a result compared with the truth of its drive, and their JSON form."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple, dataclass, fields, replace
from functools import reduce
from itertools import pairwise
from operator import add
from typing import Any, TypeVar

import numpy as np

from wayside.pipeline.statistics import (
    Interval,
    SigmaShare,
    Spread,
    fraction,
    rate_interval,
    share_interval,
    sigma_share,
    spread,
)

Row = Mapping[str, Any]
AXES = {"lateral": "sigma_lateral_m", "up": "sigma_up_m", "along": "sigma_along_m"}
"""Axes of a position error, and the columns of their stated standard deviations."""
CONFIDENCES = (0.0, 0.5, 0.9, 0.99, 1.0)
"""Ends of the ranges that rows are counted in; a row at an end belongs to the range above."""
NO_KIND = "other"
"""Kind of a wanted sign whose label names none, where others do."""
FALSE_COLUMNS = ("sign_id", "best_frame", "best_box", "color", "shape")
"""Columns that are kept of a false row, besides its cause."""
_COMMON = (
    *("wanted", "found_count", "recall", "recall_interval", "precision", "precision_interval"),
    *("images", "false_per_100_images", "false_per_100_images_interval", "learned_by"),
)


@dataclass(frozen=True, slots=True)
class Duplicate:
    """A reported row on a panel that a better row is on."""

    sign_id: str
    panel: int | str
    """The panel of the truth."""
    better: str
    """`sign_id` of the better row."""


@dataclass(frozen=True, slots=True)
class MissCause:
    """Why a wanted sign was not found."""

    id: int | str
    """Of the sign in the truth."""
    step: str
    """Where it was lost: a key of `misses.STEPS`."""
    reason: str
    """Verdict or status there."""
    views: dict[str, int]
    """Number of its views by verdict."""
    row: str | None = None
    """`sign_id` of the reported row on it."""
    distance_m: float | None = None
    """Distance of that row from it."""


@dataclass(frozen=True, slots=True)
class KindCount:
    """Signs of one kind that should be found, and how many were found."""

    kind: str
    wanted: int
    found: int


@dataclass(frozen=True, slots=True)
class ConfidenceBin:
    """Rows of a range of confidence: how many, how many of them right, their mean confidence (nan: no rows)."""

    low: float
    high: float
    rows: int
    right: int
    mean: float

    @property
    def name(self) -> str:
        """Both ends."""
        return f"{self.low:g} to {self.high:g}"


def confidence_bin(stated: Iterable[tuple[float, bool]], low: float, high: float) -> ConfidenceBin:
    """The rows between two confidences, of which `stated` has the confidence and whether they are right."""
    own = [one for one in stated if low <= one[0] < high or one[0] == high == 1]
    mean = float(np.mean([confidence for confidence, _ in own])) if own else float("nan")
    return ConfidenceBin(low, high, len(own), sum(right for _, right in own), mean)


@dataclass(frozen=True, slots=True)
class Match:
    """A reported panel and the wanted true one it was matched with."""

    sign: Row
    """Row of `signs.parquet`."""
    panel: Row
    """Entry of the truth."""
    error_m: tuple[float, float, float]
    """Reported minus true position: lateral, up, along, in the camera frame of `best_frame`."""


@dataclass(frozen=True, slots=True)
class Backs:
    """Rows of status `back`."""

    reported: int = 0
    right: int = 0
    """Those on a panel seen from behind."""
    in_view: int = 0
    """Panels seen from behind, as tall and in as many images as a front that should be found, hidden ones too."""

    def __add__(self, other: "Backs") -> "Backs":
        """Those of both."""
        return Backs(*map(add, astuple(self), astuple(other)))


@dataclass(frozen=True)
class Evaluation:
    """Which wanted signs were found, and which rows are right."""

    wanted: int = 0
    """Signs that should be found."""
    found: tuple[Any, ...] = ()
    """Those that were: matches on a rendered drive, ids of labels on a real one."""
    right: int = 0
    """Reported rows that are right."""
    false: tuple[Row, ...] = ()
    """Reported rows that are not, each with the known object it lies on as `cause`."""
    missed: tuple[Any, ...] = ()
    """Wanted signs that were not found: entries of the truth, or ids of labels."""
    duplicates: tuple[Duplicate, ...] = ()
    """Second rows on a sign. They are false on a rendered drive, right on a real one."""
    causes: tuple[MissCause, ...] = ()
    """Of the missed, in their order."""
    images: int | None = None
    """Read by the run. None: not known."""
    learned_by: tuple[str, ...] | None = None
    """Models of the run that were learned from this drive. None: not known."""
    stated: tuple[tuple[float, bool], ...] = ()
    """Confidence of each row, uncertain ones among them, and whether it is right."""

    @property
    def found_count(self) -> int:
        """How many signs were found of those that should be."""
        return len(self.found)

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
    def false_per_100_images(self) -> float | None:
        """False rows per 100 images; None where the images are not known."""
        return 100 * len(self.false) / self.images if self.images else None

    @property
    def false_per_100_images_interval(self) -> Interval | None:
        """95 % interval of that rate."""
        return rate_interval(len(self.false), (self.images or 0) / 100)

    @property
    def reliability(self) -> tuple[ConfidenceBin, ...]:
        """The rows by `CONFIDENCES`; ranges without a row are left out."""
        bins = (confidence_bin(self.stated, *ends) for ends in pairwise(CONFIDENCES))
        return tuple(one for one in bins if one.rows)

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys; intervals are [low, high] at 95 %, null where nothing was counted."""
        figures = {name: getattr(self, name) for name in _COMMON} | {"false": list(self.false)}
        for name in ("duplicates", "causes", "reliability"):
            figures[name] = [asdict(one) for one in getattr(self, name)]
        return figures | {"missed": list(self.missed)}


@dataclass(frozen=True)
class RenderedEvaluation(Evaluation):
    """Figures of a rendered drive, whose truth is exact; errors are absolute, of wanted panels that were found.

    Rows on panels that need not be found count as neither right nor false.
    """

    found: tuple[Match, ...] = ()
    backs: Backs = Backs()

    @property
    def error_m(self) -> dict[str, Spread]:
        """Position error by axis, and its length."""
        errors = np.array([match.error_m for match in self.found], np.float64).reshape(-1, 3)
        by_axis = {name: spread(np.abs(errors[:, i])) for i, name in enumerate(AXES)}
        return by_axis | {"total": spread(np.linalg.norm(errors, axis=1))}

    @property
    def sigma_share(self) -> dict[str, SigmaShare]:
        """How often the stated standard deviations hold, by axis."""
        return {
            axis: sigma_share(
                [match.error_m[i] for match in self.found],
                [match.sign[column] for match in self.found],
            )
            for i, (axis, column) in enumerate(AXES.items())
        }

    def size_error(self, name: str) -> Spread:
        """Error of the `width` or the `height` as a fraction of the true one."""
        pairs = self._pairs(f"panel_{name}_m", f"{name}_m")
        return spread(abs(a - b) / b for a, b in pairs)

    @property
    def bottom_error_m(self) -> Spread:
        """Error of the lower edge above the road."""
        return spread(abs(a - b) for a, b in self._pairs("bottom_m", "bottom_m"))

    def class_right(self, name: str) -> float | None:
        """Fraction of the colours (`color`) or shapes (`shape`) that are right."""
        return fraction([match.sign[name] == match.panel[name] for match in self.found])

    def confusion(self, name: str) -> dict[str, int]:
        """Counts of colours or shapes by `true -> reported`."""
        pairs = Counter(f"{match.panel[name]} -> {match.sign[name]}" for match in self.found)
        return dict(sorted(pairs.items()))

    def _pairs(self, reported: str, true: str) -> list[tuple[float, float]]:
        """Reported and true lengths of the matches whose reported one is known."""
        pairs = ((match.sign[reported], match.panel[true]) for match in self.found)
        return [(a, b) for a, b in pairs if a is not None]

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys."""
        return super().to_json() | {
            "error_m": {name: asdict(value) for name, value in self.error_m.items()},
            "width_error": asdict(self.size_error("width")),
            "height_error": asdict(self.size_error("height")),
            "bottom_error_m": asdict(self.bottom_error_m),
            "sigma_share": {
                name: dict(zip(("n", "1", "2"), value, strict=True))
                for name, value in self.sigma_share.items()
            },
            "color_right": self.class_right("color"),
            "shape_right": self.class_right("shape"),
            "color_confusion": self.confusion("color"),
            "shape_confusion": self.confusion("shape"),
            "found": [[match.sign["sign_id"], match.panel["id"]] for match in self.found],
            "backs": asdict(self.backs),
        }


@dataclass(frozen=True)
class RealEvaluation(Evaluation):
    """Figures of a real drive with hand-made boxes.

    The labels are not complete: `precision` is a lower bound, and every false row is worth a look. Rows on a label
    that is not wanted are right as well.
    """

    by_kind: tuple[tuple[str, bool], ...] = ()
    """Kind of each wanted label, and whether it was found. Empty: no label names its kind."""

    @property
    def kinds(self) -> tuple[KindCount, ...]:
        """The wanted signs by kind, the most frequent first."""
        wanted = Counter(kind for kind, _ in self.by_kind)
        found = Counter(kind for kind, was_found in self.by_kind if was_found)
        return tuple(KindCount(kind, count, found[kind]) for kind, count in wanted.most_common())

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys."""
        return super().to_json() | {
            "found": list(self.found),
            "touching": self.right,
            "kinds": [
                asdict(kind) | {"recall_interval": share_interval(kind.found, kind.wanted)}
                for kind in self.kinds
            ],
        }


_Kind = TypeVar("_Kind", bound=Evaluation)


def together(evaluations: Iterable[_Kind]) -> _Kind:
    """Several drives evaluated as one, by their counts. Without drives nothing is wanted or found."""
    parts: list[Any] = list(evaluations) or [RenderedEvaluation()]
    values = {one.name: [getattr(part, one.name) for part in parts] for one in fields(parts[0])}
    joined = {
        name: None if name == "learned_by" or None in some else reduce(add, some)
        for name, some in values.items()
    }
    result: _Kind = replace(parts[0], **joined)
    return result
