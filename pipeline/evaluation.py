"""How a result compares with the truth: the figures and their JSON form."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from wayside.pipeline.evaluation_findings import (
    Backs,
    Duplicate,
    FalseSign,
    KindCount,
    Match,
    MissCause,
    MissedPanel,
)
from wayside.pipeline.reliability import ConfidenceBin, bins_together
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

AXES = ("lateral", "up", "along")


class _Shares(ABC):
    """What every evaluation counts, as shares with their intervals."""

    __slots__ = ()
    wanted: int
    false: tuple[FalseSign, ...]
    duplicates: tuple[Duplicate, ...]
    images: int | None
    reliability: tuple[ConfidenceBin, ...]

    @property
    @abstractmethod
    def found_count(self) -> int:
        """Wanted signs that were found."""

    @property
    @abstractmethod
    def right(self) -> int:
        """Reported rows that count as right in the precision."""

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


@dataclass(frozen=True, slots=True)
class RenderedEvaluation(_Shares):
    """Figures of a rendered drive, whose truth is exact; errors are absolute, of wanted panels that were found.

    `false` are all rows that no panel was matched with, duplicates among them. Panels that need not be found count in
    the precision as neither. `images`: read by the run, None where not known; `learned_by`: models of the run that were
    learned from this drive, None where not known; `causes`: of the missed, in their order; `reliability`: of the
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
    def found_count(self) -> int:
        """Wanted panels that were found."""
        return len(self.matches)

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
        backs=Backs(*(sum(getattr(e.backs, one.name) for e in all_of) for one in fields(Backs))),
        duplicates=tuple(row for e in all_of for row in e.duplicates),
        causes=tuple(cause for e in all_of for cause in e.causes),
        images=_sum_images(all_of),
        reliability=bins_together(e.reliability for e in all_of),
    )


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
        """Wanted labels that were found."""
        return len(self.found)

    @property
    def right(self) -> int:
        """Rows that lie on a label."""
        return self.touching

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys."""
        return _common_json(self) | {
            "missed": list(self.missed),
            "found": list(self.found),
            "touching": self.touching,
            "kinds": [
                asdict(kind) | {"recall_interval": share_interval(kind.found, kind.wanted)}
                for kind in self.kinds
            ],
        }


def together_real(evaluations: Iterable[RealEvaluation]) -> RealEvaluation:
    """Several real drives evaluated as one, by their counts; labels are not renamed."""
    all_of = list(evaluations)
    kinds: dict[str, tuple[int, int]] = {}
    for kind in (kind for e in all_of for kind in e.kinds):
        wanted, found = kinds.get(kind.kind, (0, 0))
        kinds[kind.kind] = wanted + kind.wanted, found + kind.found
    return RealEvaluation(
        wanted=sum(e.wanted for e in all_of),
        found=tuple(name for e in all_of for name in e.found),
        touching=sum(e.touching for e in all_of),
        false=tuple(sign for e in all_of for sign in e.false),
        missed=tuple(name for e in all_of for name in e.missed),
        duplicates=tuple(row for e in all_of for row in e.duplicates),
        kinds=tuple(KindCount(name, *counts) for name, counts in kinds.items()),
        causes=tuple(cause for e in all_of for cause in e.causes),
        images=_sum_images(all_of),
        reliability=bins_together(e.reliability for e in all_of),
    )


Evaluation = RenderedEvaluation | RealEvaluation


def _sum_images(evaluations: Sequence[Evaluation]) -> int | None:
    images = [e.images for e in evaluations if e.images is not None]
    return sum(images) if len(images) == len(evaluations) else None


def _common_json(evaluation: Evaluation) -> dict[str, Any]:
    """What every evaluation has; intervals are [low, high] at 95 %, null where nothing was counted."""
    return {
        "wanted": evaluation.wanted,
        "found_count": evaluation.found_count,
        "recall": evaluation.recall,
        "recall_interval": evaluation.recall_interval,
        "precision": evaluation.precision,
        "precision_interval": evaluation.precision_interval,
        "images": evaluation.images,
        "false_per_100_images": evaluation.false_per_100_images,
        "false_per_100_images_interval": evaluation.false_per_100_images_interval,
        "learned_by": None if evaluation.learned_by is None else list(evaluation.learned_by),
        "false": [sign.to_json() for sign in evaluation.false],
        "duplicates": [asdict(row) for row in evaluation.duplicates],
        "causes": [asdict(cause) for cause in evaluation.causes],
        "reliability": [asdict(one) for one in evaluation.reliability],
    }
