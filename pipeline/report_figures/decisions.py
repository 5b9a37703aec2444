"""Chapters 9 and 10: the most powerful test of a stated false-alarm rate, and ROC curves of the colours.

Two hypotheses on a value y: no sign, with density p0, or a sign, with density p1. No test of false-alarm rate alpha has
more power than the one that accepts where p1 / p0 is at least eta (Neyman and Pearson 1933). The value of eta accepts
whatever is not a sign with probability alpha (report eq. 9.3 to 9.6).
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import erfinv

from wayside.pipeline.learning.asked import ClassifierSamples
from wayside.pipeline.learning.curves import ALL, RocCurve, roc_curves
from wayside.pipeline.learning.labelled import ON
from wayside.pipeline.learning.page import INKS, RATES, TEXT, Figure, draw_roc, new_axes, svg
from wayside.pipeline.learning.thresholds import Flags, Values
from wayside.pipeline.report_figures.drive import IMAGE_WIDE, Drive, figure, photo, reached
from wayside.pipeline.statistics import share_words
from wayside.schemas.detections import COLOR_RGB
from wayside.stages.geometry import box_areas

REPORT_MEAN, REPORT_VARIANCE, REPORT_OFF = 118.337, 1489.0, (20.0, 252.6)
"""Eq. 9.1: red of pixels of no white sign, N(118.337, 1489) on 20 to 252.6: cut, not scaled, of integral 0.99434."""

REPORT_GROWTH, REPORT_FACTOR, REPORT_ON = 235.0**0.5, 4.211e-9, (136.2, 253.8)
"""Eq. 9.2: red of pixels of white signs, 4.211e-9 exp(y / sqrt 235) on 136.2 to 253.8."""

LEVELS = np.arange(256.0)
"""Of the red of a pixel."""
Law = tuple[str, Values, Values]
"""Whose densities these are, p0 and p1 at all levels."""


def report_densities(values: Values) -> Law:
    """The report's densities (n,) of the red of no sign and of white signs (eq. 9.1 and 9.2), as printed."""
    off = np.exp(-((values - REPORT_MEAN) ** 2) / (2 * REPORT_VARIANCE))
    off /= np.sqrt(2 * np.pi * REPORT_VARIANCE)
    on = REPORT_FACTOR * np.exp(values / REPORT_GROWTH)
    off[(values < REPORT_OFF[0]) | (values > REPORT_OFF[1])] = 0
    on[(values < REPORT_ON[0]) | (values > REPORT_ON[1])] = 0
    return "report", off, on


def likelihood_ratio(off: Values, on: Values) -> Values:
    """p1 / p0 (n,), eq. 9.3: inf where only signs have a density, 0 where neither has one."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(on > 0, on / off, 0.0)


def most_powerful_test(off: Values, on: Values, alpha: float) -> Flags:
    """Which of n values the test of largest power accepts whose false-alarm rate is at most alpha (eq. 9.4 to 9.6).

    `off`, `on` (n,): probabilities of the values without and with a sign. Of equal ratios all are accepted or none.
    """
    ratio = likelihood_ratio(off, on)
    order = np.argsort(-ratio, kind="stable")
    ends = np.append(ratio[order][1:] < ratio[order][:-1], True)
    allowed = np.flatnonzero(ends & (off[order].cumsum() <= alpha) & (ratio[order] > 0))
    accepted = np.zeros(len(ratio), np.bool_)
    accepted[order[: allowed[-1] + 1 if len(allowed) else 0]] = True
    return accepted


def report_threshold(alpha: float) -> float:
    """Red from which a pixel belongs to a white sign, by eq. 9.7, which has a value for alpha from 0 to 0.99975.

    167.73 at alpha 0.1 and 190.77 at 0.03. The captions of figures 9.5 and 9.6 say 172 and 207 for these, which are the
    thresholds of alpha 0.0819 and 0.0105. The constant 0.9995 is the error function at the upper end of eq. 9.1 alone;
    the exact tail gives 167.79 and 190.91.
    """
    return float(REPORT_MEAN - 54.57 * erfinv(2 * alpha - 0.9995))


def report_power(threshold: float) -> float:
    """Power of a threshold on the red, by eq. 9.8, cut to 0 to 1: 0.9967 at 167.73."""
    return float(np.clip(6.4555e-8 * (15495907.18 - np.exp(threshold / REPORT_GROWTH)), 0.0, 1.0))


REPORT_GREEN, NEAR = 0.018, 0.1
"""Figure 10.1: false positive rate with which all green signs are found, and to where its axis is magnified."""
ALPHAS, CAPTIONS = (0.1, 0.05, 0.03, 0.01), {0.1: 172, 0.03: 207}
"""Rates of the table of figure 9.3, and thresholds that the captions of figures 9.5 and 9.6 give for theirs."""
_IMAGES, _PIXELS, _SEED, _SMOOTH = 12, 20_000, 1, 3.0
"""Images with white signs whose pixels are taken, pixels of either kind at most, which of them, and the standard
deviation that their counts are smoothed with, levels."""


def neyman_pearson_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 9.1 to 9.6."""
    frames = _frames_with_white(drive)
    images = drive.images(frames)
    on, off = _pixels(drive, images)
    densities = [report_densities(LEVELS)]
    ours = "no labelled white sign: the report's own densities only"
    if len(on) and len(off):
        counts = (np.bincount(own[:, 0].astype(int), minlength=256) / len(own) for own in (off, on))
        p0, p1 = (gaussian_filter1d(own, _SMOOTH) for own in counts)
        densities.append(("this drive", p0, p1))
        ours = f"red of {len(on)} pixels of white signs and {len(off)} beside them, in {len(images)} images"
    yield _densities(densities, ours)
    yield _ratio(densities)
    yield _power(*densities[1:])
    if images:
        rgb = images[frames[0]]
        yield figure("9.4").shown(f"frame {frames[0]}", photo(rgb, wide=IMAGE_WIDE))
        for number, alpha in (("9.5", 0.1), ("9.6", 0.03)):
            yield _decided(rgb, number, report_threshold(alpha), on, off)


def color_curves(drive: Drive) -> dict[str, RocCurve]:
    """The ROC curve of each colour that has signs and others."""
    found = roc_curves({"color": drive.samples["color"].known()}, drive.settings, drive.models)
    return {one.name: one for one in found if one.name != ALL and one.two_sided}


def rates_at(curve: RocCurve, threshold: float) -> tuple[tuple[int, int], ...]:
    """TPR (eq. 10.1) and FPR (eq. 10.2) at a threshold: how many are accepted, and how many there are."""
    on, off = (own & curve.within(threshold) for own in (curve.on, ~curve.on))
    return (int(on.sum()), curve.positives), (int(off.sum()), curve.negatives)


def roc_figures(drive: Drive) -> Iterator[Figure]:
    """Figure 10.1 for each colour, and the report's claim for green."""
    curves = color_curves(drive)
    if not curves:
        return
    pictures, key = [], "ring: knee; dot: threshold of a run"
    for end, words in ((1.0, key), (NEAR, f"the same magnified; {key}")):
        axes = new_axes((0, end), (0, 1), RATES)
        for name, one in curves.items():
            rgb = (max(v - 30, 0) for v in COLOR_RGB[name])
            ink = TEXT if name == "white" else "#{:02x}{:02x}{:02x}".format(*rgb)
            draw_roc(axes, one, ink, name.replace("_", " "), used=one.used_row)
        pictures.append(svg(axes, words))
    head = ("colour", "signs", "others", "area", "TPR of a run", "FPR of a run")
    rows: list[Sequence[str]] = [(*head, "FPR where all signs pass")]
    words, claim = "no labelled green sign", "open"
    for name, one in curves.items():
        signs = one.value[one.on]
        passed, others = rates_at(one, signs.max() if one.accept_below else signs.min())[1]
        shares = [share_words(*own) for own in (*rates_at(one, one.used), (passed, others))]
        counts = str(one.positives), str(one.negatives), f"{one.area:.4f}"
        rows.append((name.replace("_", " "), *counts, *shares))
        if name == "green":
            words = f"green: all signs pass with FPR {shares[-1]}"
            claim = reached(others - passed, others, 1 - REPORT_GREEN)
    yield figure("10.1").shown(words, *pictures, table=rows, claim=claim)
    yield _confusion(drive.samples["color"].known())


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


def _pixels(drive: Drive, images: dict[int, NDArray[np.uint8]]) -> list[Values]:
    """Colours of pixels of white signs (their middle four fifths) and of what is no sign, (n, 3) each."""
    draw, faces = np.random.default_rng(_SEED), drive.faces
    found = [[np.zeros((0, 3))], [np.zeros((0, 3))]]
    for frame, rgb in sorted(images.items()):
        inside, outside = np.zeros(rgb.shape[:2], bool), np.ones(rgb.shape[:2], bool)
        for row in np.flatnonzero(faces.frame == frame):
            x0, y0, x1, y1 = faces.box[row]
            outside[max(int(y0) - 1, 0) : int(y1) + 2, max(int(x0) - 1, 0) : int(x1) + 2] = False
            if faces.color[row] == "white" and faces.example[row]:
                dx, dy = 0.1 * (x1 - x0), 0.1 * (y1 - y0)
                rows = slice(max(round(y0 + dy), 0), round(y1 - dy))
                inside[rows, max(round(x0 + dx), 0) : round(x1 - dx)] = True
        for kept, mask in zip(found, (inside, outside), strict=True):
            pixels = rgb[mask].astype(np.float64)
            kept.append(pixels[draw.permutation(len(pixels))[: _PIXELS // _IMAGES]])
    return [np.concatenate(own) for own in found]


def _densities(densities: Sequence[Law], ours: str) -> Figure:
    top = max(max(off.max(), np.quantile(on, 0.99)) for _, off, on in densities)
    axes = new_axes((0, 255), (0, 1.1 * top), ("red", "density"))
    for i, (name, off, on) in enumerate(densities):
        style = "--" if i else "-"
        axes.plot(LEVELS, off, style, color=INKS[2 * i], label=f"{name}: no sign, p0")
        axes.plot(LEVELS, on, style, color=INKS[2 * i + 1], label=f"{name}: white sign, p1")
    return figure("9.1").shown(ours, svg(axes))


def _ratio(densities: Sequence[Law]) -> Figure:
    axes = new_axes((0, 255), (-6, 6), ("red", "log10 of the likelihood ratio"))
    words = []
    for i, (name, off, on) in enumerate(densities):
        ratio = likelihood_ratio(off, on)
        known = np.isfinite(ratio) & (ratio > 0)
        axes.plot(LEVELS[known], np.log10(ratio[known]), color=INKS[i], label=name)
        words.append(f"{name}: L is above 1 from {_from(ratio >= 1, on)}")
    return figure("9.2").shown("; ".join(words), svg(axes))


def _from(accepted: Flags, on: Values) -> str:
    """The level from which all that signs have are accepted, in words."""
    first = int(np.argmax(accepted))
    return str(first) if (accepted | (on == 0))[first:].all() else "several ranges"


def _power(own: Law | None = None) -> Figure:
    alphas = np.concatenate([np.linspace(0, 0.1, 41), np.linspace(0.11, 0.99, 45)]).tolist()
    axes = new_axes((0, 1), (0, 1), ("false-alarm rate alpha of pixels", "power"))
    equation = [report_power(report_threshold(alpha)) for alpha in alphas]
    axes.plot(alphas, equation, color=INKS[0], label="report, eq. 9.7 and 9.8")
    head = ("alpha", "report, eq. 9.7: red from", "power by 9.8", "captions")
    rows: list[tuple[str, ...]] = [(*head, "this drive: red from", "power")]
    if own is not None:
        order = np.argsort(-likelihood_ratio(*own[1:]), kind="stable")
        axes.plot(*(law[order].cumsum() for law in own[1:]), color=INKS[1], label="this drive")
    for alpha in ALPHAS:
        y = report_threshold(alpha)
        cells = [f"{alpha:g}", f"{y:.2f}", f"{report_power(y):.4f}", str(CAPTIONS.get(alpha, ""))]
        if own is not None:
            test = most_powerful_test(*own[1:], alpha)
            cells += [_from(test, own[2]), f"{own[2][test].sum():.4f}"]
        rows.append((*cells, *[""] * (6 - len(cells))))
    ours = "the equations give 167.73 and 190.77: 172 and 207 are the thresholds of alpha 0.082 and 0.0105"
    return figure("9.3").shown(ours, svg(axes), table=rows)


def _decided(rgb: NDArray[np.uint8], number: str, y: float, on: Values, off: Values) -> Figure:
    shown = np.where((rgb > y).all(axis=2, keepdims=True), rgb, 0).astype(np.uint8)
    words = [
        f"{name}: {share_words(int((pixels[:, 0] >= y).sum()), len(pixels))} by red, "
        f"{share_words(int((pixels >= y).all(axis=1).sum()), len(pixels))} by all three colours"
        for name, pixels in (("of pixels of white signs pass", on), ("of other pixels", off))
    ]
    ours = f"threshold {y:.2f} by eq. 9.7; {'; '.join(words)}"
    return figure(number).shown(ours, photo(shown, "what passes", IMAGE_WIDE))
