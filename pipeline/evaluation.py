"""How a result compares with the truth: the figures, their JSON form, and the statistics they are made of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and 95th percentile of n values, None where there are none; rounded to four decimals."""

    n: int
    median: float | None
    p95: float | None


@dataclass(frozen=True, slots=True)
class SigmaShare:
    """Fraction of n errors within one and two stated standard deviations (a normal error: 0.68 and 0.95)."""

    n: int
    one: float | None
    two: float | None

    def to_json(self) -> dict[str, Any]:
        """Keys `n`, `1`, `2`."""
        return {"n": self.n, "1": self.one, "2": self.two}


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

    reported: int
    right: int
    in_view: int


AXES = ("lateral", "up", "along")


@dataclass(frozen=True, slots=True)
class RenderedEvaluation:
    """Figures of a rendered drive, whose truth is exact; errors are absolute, of wanted panels that were found."""

    wanted: int
    matches: tuple[Match, ...]
    false: tuple[FalseSign, ...]
    missed: tuple[MissedPanel, ...]
    backs: Backs = Backs(0, 0, 0)

    @property
    def found_count(self) -> int:
        """Wanted panels that were found."""
        return len(self.matches)

    @property
    def recall(self) -> float:
        """Fraction of the wanted panels that were found; 1 where none was wanted."""
        return self.found_count / self.wanted if self.wanted else 1.0

    @property
    def precision(self) -> float:
        """Fraction of the reported panels that are true ones; panels that need not be found count as neither."""
        counted = self.found_count + len(self.false)
        return self.found_count / counted if counted else 1.0

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
        return spread(abs(a - b) / b for a, b in (m.width_m for m in self.matches) if a is not None)

    @property
    def height_error(self) -> Spread:
        """Error of the height as a fraction of the true one."""
        return spread(
            abs(a - b) / b for a, b in (m.height_m for m in self.matches) if a is not None
        )

    @property
    def bottom_error_m(self) -> Spread:
        """Error of the lower edge above the road."""
        return spread(abs(a - b) for a, b in (m.bottom_m for m in self.matches) if a is not None)

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
        return confusion((true, reported) for reported, true in (m.color for m in self.matches))

    @property
    def shape_confusion(self) -> dict[str, int]:
        """Counts by `true -> reported`."""
        return confusion((true, reported) for reported, true in (m.shape for m in self.matches))

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys."""
        return _common_json(self) | {
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


def together(evaluations: Iterable[RenderedEvaluation]) -> RenderedEvaluation:
    """Several drives evaluated as one."""
    all_of = list(evaluations)
    return RenderedEvaluation(
        wanted=sum(e.wanted for e in all_of),
        matches=tuple(m for e in all_of for m in e.matches),
        false=tuple(sign for e in all_of for sign in e.false),
        missed=tuple(panel for e in all_of for panel in e.missed),
        backs=Backs(
            *(sum(getattr(e.backs, field.name) for e in all_of) for field in fields(Backs))
        ),
    )


@dataclass(frozen=True, slots=True)
class RealEvaluation:
    """Figures of a real drive with hand-made boxes.

    The labels are not complete: `precision` is a lower bound, and every false sign is worth a look. `touching` counts
    reported signs that lie on a label, wanted or not.
    """

    wanted: int
    found: tuple[str, ...]
    touching: int
    false: tuple[FalseSign, ...]
    missed: tuple[str, ...]

    @property
    def found_count(self) -> int:
        """Wanted labels that were found."""
        return len(self.found)

    @property
    def recall(self) -> float:
        """Fraction of the wanted labels that were found; 1 where none was wanted."""
        return self.found_count / self.wanted if self.wanted else 1.0

    @property
    def precision(self) -> float:
        """Fraction of the reported signs that lie on a label."""
        counted = self.touching + len(self.false)
        return self.touching / counted if counted else 1.0

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys."""
        return _common_json(self) | {"missed": list(self.missed), "found": list(self.found)}


Evaluation = RenderedEvaluation | RealEvaluation


def _common_json(evaluation: Evaluation) -> dict[str, Any]:
    return {
        "wanted": evaluation.wanted,
        "found_count": evaluation.found_count,
        "recall": evaluation.recall,
        "precision": evaluation.precision,
        "false": [sign.to_json() for sign in evaluation.false],
    }


def spread(values: Iterable[float] | NDArray[np.float64]) -> Spread:
    """Median and 95th percentile (linear interpolation)."""
    array = np.asarray(list(values), np.float64)
    if array.size == 0:
        return Spread(0, None, None)
    return Spread(
        int(array.size),
        round(float(np.median(array)), 4),
        round(float(np.percentile(array, 95)), 4),
    )


def fraction(flags: Sequence[bool]) -> float | None:
    """Fraction of true flags, rounded to four decimals; None where there are none."""
    return round(sum(flags) / len(flags), 4) if flags else None


def sigma_share(errors: Iterable[float], sigmas: Iterable[float | None]) -> SigmaShare:
    """Fraction of errors within one and two of their own sigmas; unknown and zero sigmas are left out."""
    ratios = [abs(e) / s for e, s in zip(errors, sigmas, strict=True) if s]
    return SigmaShare(
        len(ratios), fraction([r <= 1 for r in ratios]), fraction([r <= 2 for r in ratios])
    )


def confusion(pairs: Iterable[tuple[str | None, str | None]]) -> dict[str, int]:
    """Count `true -> reported`, sorted by name."""
    return dict(sorted(Counter(f"{true} -> {reported}" for true, reported in pairs).items()))
