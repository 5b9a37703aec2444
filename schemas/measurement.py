"""How a landmark was measured: the registered views of its panel, and the adjustment with the motion around it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Alignment(NamedTuple):
    """Where a template was found: sample x of the template shows at middle + shift + stretch * (x - middle).

    shift, stretch (2,): right and down, samples; gain, bias: template = gain * patch + bias; zncc: zero-mean normalised
    cross-correlation, 1 at best; covariance (4, 4): of shift and stretch, from the residuals.
    """

    shift: NDArray[np.float64]
    stretch: NDArray[np.float64]
    gain: float
    bias: float
    zncc: float
    covariance: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PanelView:
    """A rectified view of a panel: its frame, rgb (rows, columns, 3) float32, and how it lies on the template."""

    frame: int
    rgb: NDArray[np.float32] = field(repr=False)
    alignment: Alignment = field(repr=False)


@dataclass(frozen=True, slots=True)
class WindowResidual:
    """The adjustment of a landmark together with the frames around it.

    first_frame, last_frame: of the window; history_sigmas: RMS residual per coordinate over all ties and views, in
    their standard deviations, at the start and after each iteration; start, position (3,): the landmark before
    and after, in the drive's frame, metres.
    """

    first_frame: int
    last_frame: int
    history_sigmas: tuple[float, ...]
    start: NDArray[np.float64]
    position: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the measurement of a landmark rests on.

    views: those registered, the template first; outline (k, 2, 2): ends of the segments of the face's outline, samples
    of the template (None: none was found), without its rounded corners; shape: that of the outline; face (4,): the box
    [left, top, right, bottom] round all of it; adjustment: None where there was none.
    """

    track_id: int
    views: tuple[PanelView, ...]
    outline: NDArray[np.float64] | None
    shape: str | None
    face: NDArray[np.float64] | None
    adjustment: WindowResidual | None
