"""Chapters 9 and 10: the most powerful test of a stated false-alarm rate, and ROC curves of the colours.

Two hypotheses on a value y: no sign, with density p0, or a sign, with density p1. No test of false-alarm rate alpha has
more power than the one that accepts where p1 / p0 is at least eta (Neyman and Pearson 1933). The value of eta accepts
whatever is not a sign with probability alpha (report eq. 9.3 to 9.6).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfinv
from scipy.stats import gaussian_kde

from wayside.pipeline.learning.asked import ClassifierSamples
from wayside.pipeline.learning.curves import ALL, roc_curves
from wayside.pipeline.learning.labelled import ON
from wayside.pipeline.learning.page import INKS, RATES, TEXT, Figure, draw_roc, new_axes, svg
from wayside.pipeline.report_figures.drive import Drive, figure, photo
from wayside.pipeline.statistics import share_words
from wayside.schemas.detections import COLOR_RGB
from wayside.stages.geometry import box_areas

REPORT_MEAN, REPORT_VARIANCE, REPORT_OFF = 118.337, 1489.0, (20.0, 252.6)
"""Eq. 9.1: red of pixels of no white sign, N(118.337, 1489) on 20 to 252.6. It is cut, not scaled: its integral is
0.99434."""

REPORT_GROWTH, REPORT_FACTOR, REPORT_ON = 235.0**0.5, 4.211e-9, (136.2, 253.8)
"""Eq. 9.2: red of pixels of white signs, 4.211e-9 exp(y / sqrt 235) on 136.2 to 253.8."""

GRID = 2048
"""Values at which fitted densities are compared."""


@dataclass(frozen=True, slots=True)
class Densities:
    """Both densities on equally spaced values (n,): `off` of what is no sign (p0), `on` of signs (p1)."""

    values: NDArray[np.float64]
    off: NDArray[np.float64]
    on: NDArray[np.float64]

    @property
    def step(self) -> float:
        """Distance of the values."""
        return float(self.values[1] - self.values[0])

    @property
    def likelihood_ratio(self) -> NDArray[np.float64]:
        """p1 / p0 (n,), eq. 9.3: inf where only signs have a density, 0 where neither has one."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.on / self.off
        return np.where(self.on > 0, ratio, 0.0)


@dataclass(frozen=True, slots=True)
class PowerfulTest:
    """The most powerful test of a false-alarm rate.

    `accepted` (n,) bool by value. `false_alarm`, `power`: probabilities that it accepts what is no sign, and a sign.
    `threshold`: the least accepted value where all larger ones are accepted too, None where these have gaps.
    """

    accepted: NDArray[np.bool_]
    false_alarm: float
    power: float
    threshold: float | None


def fitted_densities(on: NDArray[np.floating], off: NDArray[np.floating]) -> Densities:
    """Kernel densities (Gaussian, bandwidth by Scott's rule) of the values of signs (m,) and of everything else (n,).

    Each kind has two different values at least.
    """
    together = np.concatenate([off, on])
    margin = 0.1 * float(np.ptp(together))
    grid = np.linspace(together.min() - margin, together.max() + margin, GRID)
    return Densities(grid, gaussian_kde(off)(grid), gaussian_kde(on)(grid))


def report_densities() -> Densities:
    """The report's densities of the red of white signs (eq. 9.1 and 9.2), as printed."""
    values = np.linspace(0.0, 256.0, 2**16 + 1)
    off = np.exp(-((values - REPORT_MEAN) ** 2) / (2 * REPORT_VARIANCE))
    off /= np.sqrt(2 * np.pi * REPORT_VARIANCE)
    on = REPORT_FACTOR * np.exp(values / REPORT_GROWTH)
    return Densities(
        values,
        np.where((values >= REPORT_OFF[0]) & (values <= REPORT_OFF[1]), off, 0.0),
        np.where((values >= REPORT_ON[0]) & (values <= REPORT_ON[1]), on, 0.0),
    )


def most_powerful_test(densities: Densities, alpha: float) -> PowerfulTest:
    """The test of largest power among those of false-alarm rate at most `alpha`, 0 to 1 (eq. 9.4 to 9.6)."""
    ratio, step = densities.likelihood_ratio, densities.step
    order = np.argsort(-ratio, kind="stable")
    alarm = np.cumsum(densities.off[order]) * step
    # of equal ratios all are accepted or none: a set of positive probability is not cut
    ends = np.append(ratio[order][1:] < ratio[order][:-1], True)
    allowed = np.flatnonzero(ends & (alarm <= alpha))
    last = int(allowed[-1]) if len(allowed) else -1
    accepted = np.zeros(len(ratio), np.bool_)
    accepted[order[: last + 1]] = True
    accepted &= densities.on > 0
    first = int(np.argmax(accepted)) if accepted.any() else len(accepted)
    whole = bool(accepted.any()) and bool((accepted | (densities.on <= 0))[first:].all())
    return PowerfulTest(
        accepted,
        float(densities.off[accepted].sum() * step),
        min(1.0, float(densities.on[accepted].sum() * step)),
        float(densities.values[first]) if whole else None,
    )


def report_threshold(alpha: float) -> float:
    """Red from which a pixel belongs to a white sign, by eq. 9.7, which has a value for alpha from 0 to 0.99975.

    167.73 at alpha 0.1 and 190.77 at 0.03. The captions of figures 9.5 and 9.6 say 172 and 207 for these, which are the
    thresholds of alpha 0.0819 and 0.0105. The constant 0.9995 is the error function at the upper end of eq. 9.1 alone;
    the exact tail gives 167.79 and 190.91.
    """
    return float(REPORT_MEAN - 54.57 * erfinv(2 * alpha - 0.9995))


def report_power(threshold: float) -> float:
    """Power of a threshold on the red, by eq. 9.8, cut to 0 to 1: 0.9967 at 167.73."""
    power = 6.4555e-8 * (15495907.18 - np.exp(threshold / REPORT_GROWTH))
    return float(np.clip(power, 0.0, 1.0))


CAPTIONS = {0.1: 172, 0.03: 207}
"""Thresholds that the captions of figures 9.5 and 9.6 give for their alpha."""
_IMAGES, _PIXELS, _SEED = 12, 20_000, 1
"""Images with white signs whose pixels are taken, pixels of either kind at most, and which of them."""


def neyman_pearson_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 9.1 to 9.6."""
    images = drive.images(_frames_with_white(drive))
    on, off = _pixels(drive, images)
    densities = [("report", report_densities())]
    ours = "no labelled white sign: the report's own densities only"
    if all(len(np.unique(pixels[:, 0])) > 1 for pixels in (on, off)):
        densities.append(("this drive", fitted_densities(on[:, 0], off[:, 0])))
        ours = f"red of {len(on)} pixels of white signs and {len(off)} beside them, in {len(images)} images"
    yield _densities(densities, ours)
    yield _ratio(densities)
    yield _power(densities)
    white = drive.faces.color == "white"
    area = np.where(white, box_areas(drive.faces.box), 0.0)
    frame = max(images, default=None, key=lambda f: float(area[drive.faces.frame == f].sum()))
    for number, alpha in (("9.4", None), ("9.5", 0.1), ("9.6", 0.03)):
        yield _image(images, frame, number, alpha, on, off)


def roc_figures(drive: Drive) -> Iterator[Figure]:
    """Figure 10.1 for each colour, and the report's claim for green."""
    samples = drive.samples["color"].known()
    axes = new_axes((0, 1), (0, 1), RATES)
    shipped = "at the shipped threshold: TPR"
    rows: list[Sequence[str]] = [
        ("colour", "signs", "others", "area", shipped, "FPR", "FPR where all signs pass")
    ]
    green = "no labelled green sign"
    for one in roc_curves({"color": samples}, drive.settings, drive.models):
        if one.name == ALL or not one.two_sided:
            continue
        name, on = one.name.replace("_", " "), one.on
        ink = "#{:02x}{:02x}{:02x}".format(*(max(v - 30, 0) for v in COLOR_RGB[one.name]))
        draw_roc(axes, one, TEXT if name == "white" else ink, name)
        accepted, reached = one.within(one.used), one.within(one.value[on].min())
        shares = [
            share_words(int((flags & kind).sum()), int(kind.sum()))
            for flags, kind in ((accepted, on), (accepted, ~on), (reached, ~on))
        ]
        rows.append((name, str(on.sum()), str((~on).sum()), f"{one.area:.4f}", *shares))
        if name == "green":
            green = f"green: all signs pass with FPR {shares[2]}"
    if len(rows) == 1:
        needs = "labelled signs of a colour that the report's classifier has"
        yield figure("10.1").left_out(needs)
        return
    yield figure("10.1").shown(green, svg(axes), table=rows)
    yield _confusion(samples)


def _confusion(samples: ClassifierSamples) -> Figure:
    counts = samples.confusion()
    given = [*sorted({name for _, name in counts if name != "refused"}), "refused"]
    labelled = [*sorted({name for name, _ in counts if name not in ("none", "sign")}), "none"]
    rows = [("labelled as", *(name.replace("_", " ") for name in given))]
    for kind in labelled:
        name = "no sign" if kind == "none" else kind.replace("_", " ")
        rows.append((name, *(str(counts.get((kind, other), 0)) for other in given)))
    right = sum(counts.get((kind, kind), 0) for kind in labelled)
    words = share_words(right, int((samples.label == ON).sum()))
    ours = f"segments on signs that are named right: {words}"
    return figure("10.1 (matrix)").shown(ours, table=rows)


def _frames_with_white(drive: Drive) -> list[int]:
    """Frames with a white face, those of the largest faces first."""
    faces = drive.faces
    used = faces.example & np.isin(faces.frame, list(drive.frames)) & (faces.color == "white")
    own = faces.frame[used][np.argsort(-box_areas(faces.box[used]), kind="stable")]
    return list(dict.fromkeys(own.tolist()))[:_IMAGES]


def _white_mask(
    drive: Drive, frame: int, shape: tuple[int, ...]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Pixels of an image inside white faces (their middle four fifths), and outside of all faces."""
    inside, outside = np.zeros(shape[:2], bool), np.ones(shape[:2], bool)
    faces = drive.faces
    for row in np.flatnonzero(faces.frame == frame):
        x0, y0, x1, y1 = faces.box[row]
        outside[max(int(y0) - 1, 0) : int(y1) + 2, max(int(x0) - 1, 0) : int(x1) + 2] = False
        if faces.color[row] == "white" and faces.example[row]:
            dx, dy = 0.1 * (x1 - x0), 0.1 * (y1 - y0)
            rows = slice(max(round(y0 + dy), 0), round(y1 - dy))
            inside[rows, max(round(x0 + dx), 0) : round(x1 - dx)] = True
    return inside, outside


def _pixels(
    drive: Drive, images: dict[int, NDArray[np.uint8]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Colours of pixels of white signs and of what is no sign, (n, 3) each."""
    draw = np.random.default_rng(_SEED)
    found: tuple[list[NDArray[np.float64]], ...] = ([np.zeros((0, 3))], [np.zeros((0, 3))])
    for frame, rgb in sorted(images.items()):
        for kept, mask in zip(found, _white_mask(drive, frame, rgb.shape), strict=True):
            pixels = rgb[mask].astype(np.float64)
            kept.append(pixels[draw.permutation(len(pixels))[: _PIXELS // _IMAGES]])
    return np.concatenate(found[0]), np.concatenate(found[1])


def _densities(densities: Sequence[tuple[str, Densities]], ours: str) -> Figure:
    top = max(float(max(d.off.max(), d.on.max())) for _, d in densities)
    axes = new_axes((0, 255), (0, 1.1 * top), ("red", "density"))
    for i, (name, d) in enumerate(densities):
        style = "--" if i else "-"
        axes.plot(d.values, d.off, style, color=INKS[2 * i], label=f"{name}: no sign, p0")
        axes.plot(d.values, d.on, style, color=INKS[2 * i + 1], label=f"{name}: white sign, p1")
    return figure("9.1").shown(ours, svg(axes))


def _ratio(densities: Sequence[tuple[str, Densities]]) -> Figure:
    axes = new_axes((0, 255), (-6, 6), ("red", "log10 of the likelihood ratio"))
    words = []
    for i, (name, d) in enumerate(densities):
        with np.errstate(divide="ignore"):
            ratio = np.log10(d.likelihood_ratio)
        axes.plot(d.values, np.where(np.isfinite(ratio), ratio, np.nan), color=INKS[i], label=name)
        inside = (d.values >= 0) & (d.values <= 255)
        below = np.flatnonzero(inside & (d.likelihood_ratio < 1) & (d.off > 0))
        if len(below) and below[-1] + 1 < len(d.values):
            words.append(f"{name}: L is above 1 from {d.values[below[-1] + 1]:.1f} on")
    return figure("9.2").shown("; ".join(words), svg(axes))


def _power(densities: Sequence[tuple[str, Densities]]) -> Figure:
    alphas = np.concatenate([np.linspace(0, 0.1, 41), np.linspace(0.11, 0.99, 45)]).tolist()
    axes = new_axes((0, 1), (0, 1), ("false-alarm rate alpha", "power"))
    equation = [report_power(report_threshold(alpha)) for alpha in alphas]
    axes.plot(alphas, equation, color=INKS[0], label="report, eq. 9.7 and 9.8")
    head = ("alpha", "report, eq. 9.7: red from", "power by 9.8", "captions")
    rows: list[tuple[str, ...]] = [(*head, "this drive: red from", "power")]
    own = densities[1][1] if len(densities) > 1 else None
    if own is not None:
        tests = [most_powerful_test(own, alpha) for alpha in alphas]
        points = np.array([(test.false_alarm, test.power) for test in tests])
        axes.plot(*points.T, color=INKS[1], label="this drive")
    for alpha in (0.1, 0.05, 0.03, 0.01):
        y = report_threshold(alpha)
        cells = [f"{alpha:g}", f"{y:.2f}", f"{report_power(y):.4f}", str(CAPTIONS.get(alpha, ""))]
        if own is None:
            rows.append((*cells, "", ""))
            continue
        test = most_powerful_test(own, alpha)
        reds = "several ranges" if test.threshold is None else f"{test.threshold:.1f}"
        rows.append((*cells, reds, f"{test.power:.4f}"))
    ours = "the equations give 167.73 and 190.77: 172 and 207 are the thresholds of alpha 0.082 and 0.0105"
    return figure("9.3").shown(ours, svg(axes), table=rows)


def _image(
    images: dict[int, NDArray[np.uint8]],
    frame: int | None,
    number: str,
    alpha: float | None,
    on: NDArray[np.float64],
    off: NDArray[np.float64],
) -> Figure:
    if frame is None:
        return figure(number).left_out("a labelled white sign")
    rgb = images[frame]
    if alpha is None:
        return figure(number).shown(f"frame {frame}", photo(rgb, scale=0.5))
    y = report_threshold(alpha)
    shown = np.where((rgb > y).all(axis=2, keepdims=True), rgb, 0).astype(np.uint8)
    words = [
        f"{name}: {share_words(int((pixels[:, 0] >= y).sum()), len(pixels))} by red, "
        f"{share_words(int((pixels >= y).all(axis=1).sum()), len(pixels))} by all three colours"
        for name, pixels in (("of pixels of white signs pass", on), ("of other pixels", off))
    ]
    ours = f"threshold {y:.2f} by eq. 9.7; {'; '.join(words)}"
    return figure(number).shown(ours, photo(shown, f"frame {frame}, what passes", scale=0.5))
