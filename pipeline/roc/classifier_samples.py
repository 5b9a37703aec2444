"""What a classifier was asked about, with the answer that labels give: one table for all classifiers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.samples import NEITHER

NO_CLASS = ""
"""Class of what is no sign, and of what a classifier refuses."""


@dataclass(frozen=True, slots=True)
class ClassifierSamples:
    """What one classifier was asked about, n rows, in order of drive and frame.

    classifier: its name; space: of its values; values (n, d) float64; label (n,) int8 `OFF`, `ON` or `NEITHER` a sign;
    kind (n,): class of the labelled sign in this classifier's terms, `NO_CLASS` where there is none; accepted (n,)
    bool: what it decided; named (n,): the class that it gave, `NO_CLASS` where it refused; drive (n,), frame (n,)
    int32, box (n, 4) float32: where it came from (of a landmark its best view), pixels; count (n,) int64: how many
    equal ones of the same frame the row stands for (of the size gate; else 1), their boxes nan.
    """

    classifier: str
    space: str
    values: NDArray[np.float64]
    label: NDArray[np.int8]
    kind: NDArray[np.str_]
    accepted: NDArray[np.bool_]
    named: NDArray[np.str_]
    drive: NDArray[np.str_]
    frame: NDArray[np.int32]
    box: NDArray[np.float32]
    count: NDArray[np.int64]

    def __len__(self) -> int:
        """Count rows."""
        return len(self.label)

    def select(self, rows: NDArray[Any]) -> ClassifierSamples:
        """Those rows, in that order."""
        columns = (getattr(self, f.name)[rows] for f in fields(self)[2:])
        return ClassifierSamples(self.classifier, self.space, *columns)

    def known(self) -> ClassifierSamples:
        """Those that are on a sign or off all signs."""
        return self.select(self.label != NEITHER)

    @staticmethod
    def joined(parts: Sequence[ClassifierSamples]) -> ClassifierSamples:
        """The rows of several, at least one, in that order."""
        columns = (
            np.concatenate([getattr(part, f.name) for part in parts])
            for f in fields(ClassifierSamples)[2:]
        )
        return ClassifierSamples(parts[0].classifier, parts[0].space, *columns)


def join_drives(
    drives: Iterable[Mapping[str, ClassifierSamples]],
) -> dict[str, ClassifierSamples]:
    """The samples of several drives together, by classifier."""
    parts: dict[str, list[ClassifierSamples]] = {}
    for drive in drives:
        for name, samples in drive.items():
            parts.setdefault(name, []).append(samples)
    return {name: ClassifierSamples.joined(own) for name, own in parts.items()}
