"""Plots as SVG: axes with round numbers, lines, points and bars."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wayside.pipeline.report_figures.page import Picture

_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 14.0, 12.0, 44.0
_GREY, _TEXT = "#d9dee4", "#606a76"
_HALO = 'stroke="#ffffff" stroke-width="3" paint-order="stroke"'
INKS = ("#0b61a4", "#c4500a", "#2a8c4a", "#8b2fa3", "#a08000", "#c8102e", "#5a4632", "#119da4")


class Plot:
    """A plot of a size in pixels over ranges of x and y; `picture` ends it."""

    def __init__(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        labels: tuple[str, str],
        size: tuple[int, int] = (540, 340),
        *,
        equal: bool = False,
    ) -> None:
        self._x, self._y, self._size = _opened(x), _opened(y), size
        if equal:
            self._x, self._y = _same_scale(self._x, self._y, self._area())
        self._axis: list[str] = []
        self._parts: list[str] = []
        self._words: list[str] = []
        self._legend: list[tuple[str, str]] = []
        self._axes(labels)

    def line(
        self,
        points: ArrayLike,
        ink: str,
        name: str = "",
        *,
        dashed: bool = False,
        width: float = 1.6,
    ) -> None:
        """A line through points (n, 2), broken where one is not finite."""
        values = np.asarray(points, np.float64).reshape(-1, 2)
        good = np.asarray(np.isfinite(values).all(axis=1))
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        for run in np.split(np.arange(len(values)), np.flatnonzero(np.diff(good.astype(int))) + 1):
            if len(run) > 1 and good[run[0]]:
                path = " ".join(f"{u:.1f},{v:.1f}" for u, v in self._at(values[run]))
                self._parts.append(
                    f'<polyline points="{path}" fill="none" stroke="{ink}" stroke-width="{width}"{dash}/>'
                )
        self._name(name, ink)

    def points(self, points: ArrayLike, ink: str, name: str = "", radius: float = 2.6) -> None:
        """Dots at points (n, 2)."""
        values = np.asarray(points, np.float64).reshape(-1, 2)
        for u, v in self._at(values[np.isfinite(values).all(axis=1)]):
            self._parts.append(
                f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{radius}" fill="{ink}" stroke="{_TEXT}" stroke-width="0.4"/>'
            )
        self._name(name, ink)

    def bars(self, edges: ArrayLike, heights: ArrayLike, ink: str, name: str = "") -> None:
        """Bars (n,) between edges (n + 1,)."""
        e, h = np.asarray(edges, np.float64), np.asarray(heights, np.float64)
        for low, high, top in zip(e[:-1], e[1:], h, strict=True):
            (u0, v0), (u1, v1) = self._at(np.array([[low, top], [high, self._y[0]]]))
            self._parts.append(
                f'<rect x="{u0:.1f}" y="{v0:.1f}" width="{u1 - u0:.1f}" height="{max(v1 - v0, 0):.1f}" '
                f'fill="{ink}" fill-opacity="0.6"/>'
            )
        self._name(name, ink)

    def word(self, at: tuple[float, float], words: str, ink: str = _TEXT) -> None:
        """Words beside a point."""
        ((u, v),) = self._at(np.array([at], np.float64))
        self._words.append(
            f'<text x="{u + 5:.1f}" y="{v - 4:.1f}" font-size="11" fill="{ink}" {_HALO}>{escape(words)}</text>'
        )

    def picture(self, words: str = "") -> Picture:
        """The plot as it stands."""
        (width, height), (wide, tall) = self._size, self._area()
        legend = [
            f'<text x="{_LEFT + 10}" y="{_TOP + 16 + 15 * i}" font-size="12" fill="{ink}" {_HALO}>'
            f"{escape(name)}</text>"
            for i, (name, ink) in enumerate(self._legend)
        ]
        return Picture(
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
            f'viewBox="0 0 {width} {height}" font-family="system-ui, sans-serif">'
            f"{''.join(self._axis)}"
            # what lies outside of the axes is cut off there
            f'<svg x="{_LEFT}" y="{_TOP}" width="{wide}" height="{tall}" viewBox="{_LEFT} {_TOP} {wide} {tall}">'
            f"{''.join(self._parts)}</svg>{''.join(self._words)}{''.join(legend)}</svg>",
            words,
        )

    def _name(self, name: str, ink: str) -> None:
        if name:
            self._legend.append((name, ink))

    def _area(self) -> tuple[float, float]:
        return self._size[0] - _LEFT - _RIGHT, self._size[1] - _TOP - _BOTTOM

    def _at(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        wide, tall = self._area()
        (x0, x1), (y0, y1) = self._x, self._y
        u = _LEFT + wide * (values[:, 0] - x0) / (x1 - x0)
        v = _TOP + tall * (y1 - values[:, 1]) / (y1 - y0)
        limits = (-9e3, 9e3)
        return np.column_stack([np.clip(u, *limits), np.clip(v, *limits)])

    def _axes(self, labels: tuple[str, str]) -> None:
        wide, tall = self._area()
        for value in round_steps(*self._x):
            ((u, _),) = self._at(np.array([[value, self._y[0]]]))
            self._axis.append(
                f'<line x1="{u:.1f}" y1="{_TOP}" x2="{u:.1f}" y2="{_TOP + tall}" stroke="{_GREY}"/>'
                f'<text x="{u:.1f}" y="{_TOP + tall + 15}" font-size="11" text-anchor="middle" fill="{_TEXT}">'
                f"{value:g}</text>"
            )
        for value in round_steps(*self._y):
            ((_, v),) = self._at(np.array([[self._x[0], value]]))
            self._axis.append(
                f'<line x1="{_LEFT}" y1="{v:.1f}" x2="{_LEFT + wide}" y2="{v:.1f}" stroke="{_GREY}"/>'
                f'<text x="{_LEFT - 6}" y="{v + 4:.1f}" font-size="11" text-anchor="end" fill="{_TEXT}">'
                f"{value:g}</text>"
            )
        self._axis.append(
            f'<text x="{_LEFT + wide / 2}" y="{_TOP + tall + 35}" font-size="12" text-anchor="middle" '
            f'fill="{_TEXT}">{escape(labels[0])}</text>'
            f'<text transform="translate(14 {_TOP + tall / 2}) rotate(-90)" font-size="12" text-anchor="middle" '
            f'fill="{_TEXT}">{escape(labels[1])}</text>'
        )


def round_steps(low: float, high: float, most: int = 7) -> Sequence[float]:
    """Round numbers (1, 2 or 5 times a power of ten apart) from low to high, at most so many."""
    step = 10.0 ** np.floor(np.log10((high - low) / most))
    for factor in (1, 2, 5, 10):
        if (high - low) / (step * factor) <= most:
            step *= factor
            break
    first = np.ceil(low / step - 1e-9)
    # a sum with 0 is never -0
    return [
        float(round(k * step, 10)) + 0.0 for k in np.arange(first, np.floor(high / step + 1e-9) + 1)
    ]


def _opened(ends: tuple[float, float]) -> tuple[float, float]:
    low, high = ends
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _same_scale(
    x: tuple[float, float], y: tuple[float, float], area: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    unit = max((x[1] - x[0]) / area[0], (y[1] - y[0]) / area[1])
    (cx, cy), (w, h) = ((sum(x) / 2, sum(y) / 2), (unit * area[0] / 2, unit * area[1] / 2))
    return (cx - w, cx + w), (cy - h, cy + h)
