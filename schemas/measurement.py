"""How a landmark was measured: the registered views of its panel, and the adjustment with the motion around it."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Alignment(NamedTuple):
    """Where a template was found: its sample x shows at middle + shift + stretch * (x - middle)."""

    shift: NDArray[np.float64]
    """Right and down, (2,), samples."""
    stretch: NDArray[np.float64]
    """Along both axes, (2,)."""
    gain: float
    """template = gain * patch + bias."""
    bias: float
    """See `gain`."""
    zncc: float
    """Zero-mean normalised cross-correlation, 1 at best."""
    covariance: NDArray[np.float64]
    """Of shift and stretch, from the residuals, (4, 4)."""


@dataclass(frozen=True, slots=True)
class PanelView:
    """A rectified view of a panel."""

    frame: int
    """Index of the frame in the log."""
    rgb: NDArray[np.uint8] = field(repr=False)
    """(rows, columns, 3)."""
    alignment: Alignment = field(repr=False)
    """How it lies on the template."""


@dataclass(frozen=True, slots=True)
class WindowResidual:
    """The adjustment of a landmark together with the frames around it."""

    first_frame: int
    """Of the window."""
    last_frame: int
    """Of the window."""
    history_sigmas: tuple[float, ...]
    """RMS residual in standard deviations, at the start and after each iteration."""
    start: NDArray[np.float64]
    """The landmark before, in the frame of the drive, (3,), metres."""
    position: NDArray[np.float64]
    """The landmark after, in the frame of the drive, (3,), metres."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the measurement of a landmark rests on."""

    track_id: int
    """Number of the landmark."""
    views: tuple[PanelView, ...]
    """Those registered, the template first."""
    outline: NDArray[np.float64] | None
    """Ends of the straight sides of the face, (k, 2, 2), samples of the template. None: no outline was found."""
    shape: str | None
    """Shape of the outline. None: none was found."""
    face: NDArray[np.float64] | None
    """Box round the outline: left, top, right, bottom, (4,), samples. None: none was found."""
    adjustment: WindowResidual | None
    """None: there was none."""
