"""Plots by matplotlib, and what `figures.html` shows of them: one page without scripts or other files.

The same values give the same bytes.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO, StringIO
from typing import Any, Self

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Sheet

from wayside.pipeline.learning.curves import RocCurve

CLAIMS = ("not met", "open", "met")
"""What a drive shows about a claim; open: it has too few samples."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as HTML, an `img` or an `svg`, and its words."""

    html: str
    words: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of the report, or without a number pictures and a table under a chapter.

    `number`, `title`. `report`: what the report shows and which number it gives. `ours`: the same of this drive.
    `needs`: why it is left out (empty: it is not). `table`: rows of cells, the first one the head. `claim`: whether
    this drive meets a claim of the report, one of `CLAIMS` (empty: the report makes no claim).
    """

    number: str
    title: str
    report: str
    ours: str = ""
    pictures: Sequence[Picture] = ()
    needs: str = ""
    table: Sequence[Sequence[str]] = ()
    claim: str = ""

    def shown(
        self, ours: str, *pictures: Picture, table: Sequence[Sequence[str]] = (), claim: str = ""
    ) -> Self:
        """The same figure with the result of this drive."""
        claim = claim or self.claim
        return replace(self, ours=ours, pictures=pictures, needs="", table=table, claim=claim)

    @property
    def anchor(self) -> str:
        """Its name in links."""
        return "figure-" + re.sub(r"[^0-9a-z]+", "-", self.number).strip("-")


INKS = ("#0b61a4", "#c4500a", "#2a8c4a", "#8b2fa3", "#a08000", "#c8102e", "#5a4632", "#119da4")
TEXT, FAINT, GRID, BAND = "#161b22", "#606a76", "#d9dee4", "#dfe7f1"
RATES = ("false positive rate (10.2)", "true positive rate (10.1)")
"""Axes of a ROC curve."""
_PER_INCH = 96
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "wayside",
    "font.size": 10,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": FAINT,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "legend.frameon": False,
}
_PLAIN: dict[str, Any] = dict.fromkeys(("Creator", "Date", "Format", "Type"))
"""Metadata without a date and without the address of a format description."""


def new_axes(
    x: tuple[float, float],
    y: tuple[float, float],
    labels: tuple[str, str],
    size: tuple[float, float] = (540, 340),
    *,
    equal: bool = False,
) -> Axes:
    """Empty axes over ranges of x and y in a figure of a size in pixels; equal: both in one scale."""
    with matplotlib.rc_context(_STYLE):
        axes = Sheet((size[0] / _PER_INCH, size[1] / _PER_INCH), layout="constrained").subplots()
        axes.set(xlim=x, ylim=y, xlabel=labels[0], ylabel=labels[1])
        if equal:
            axes.set_aspect("equal", adjustable="box")
    return axes


def draw_roc(
    axes: Axes, curve: RocCurve, ink: str, name: str, *, used: int | None = None, width: float = 1.6
) -> None:
    """A curve with its knee as a ring, and the row that a run uses as a dot."""
    x, y = np.append(curve.fpr, 1.0), np.append(curve.tpr, 1.0)
    axes.plot(x, y, color=ink, linewidth=width, label=name)
    ring, dot = {"markerfacecolor": "white", "markersize": 8}, {"markersize": 6}
    for row, mark in ((curve.knee, ring), (used, dot)):
        if row is not None and x[row] <= axes.get_xlim()[1]:
            axes.plot(x[row], y[row], "o", color=ink, clip_on=False, zorder=3, **mark)


def draw_band(axes: Axes, curve: RocCurve) -> None:
    """The 95 % band of the true positive rate, where there is one."""
    if curve.bands.tpr is not None:
        axes.fill_between(curve.fpr, *curve.bands.tpr.T, color=BAND, linewidth=0)


def legend_beside(axes: Axes, words: str) -> None:
    """The names of all lines at the right of the axes."""
    _sheet(axes).legend(
        loc="outside right upper", title=words, alignment="left", frameon=False, labelspacing=0.8
    )


def svg(axes: Axes, words: str = "") -> Picture:
    """The figure of these axes for a page."""
    text = StringIO()
    with matplotlib.rc_context(_STYLE):
        if names := axes.get_legend_handles_labels()[1]:
            columns = 2 if max(map(len, names)) > 20 else 4
            _sheet(axes).legend(loc="outside upper left", ncols=columns, labelcolor="linecolor")
        _sheet(axes).savefig(text, format="svg", metadata=_PLAIN)
    drawn = text.getvalue()
    return Picture(re.sub(r' xmlns(:\w+)?="[^"]*"', "", drawn[drawn.index("<svg") :]), words)


def png(axes: Axes) -> bytes:
    """The figure of these axes for a file."""
    image = BytesIO()
    with matplotlib.rc_context(_STYLE):
        _sheet(axes).savefig(image, format="png", dpi=_PER_INCH, metadata={"Software": None})
    return image.getvalue()


def _sheet(axes: Axes) -> Sheet:
    sheet = axes.figure
    assert isinstance(sheet, Sheet)
    return sheet
