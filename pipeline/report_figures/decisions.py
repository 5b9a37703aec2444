"""Chapters 9 and 10: the test of Neyman and Pearson on the red of white signs, and ROC curves of the colours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.samples import OFF, ON
from wayside.pipeline.report_figures.gather import Drive
from wayside.pipeline.report_figures.numbers import share_words
from wayside.pipeline.report_figures.page import Figure, photo
from wayside.pipeline.report_figures.plots import INKS, Plot
from wayside.pipeline.roc.classifier_samples import NO_CLASS, ClassifierSamples
from wayside.pipeline.roc.curves import Scores, resampled_groups, roc_curve
from wayside.pipeline.roc.neyman_pearson import (
    Densities,
    fitted_densities,
    most_powerful_test,
    report_densities,
    report_power,
    report_threshold,
)
from wayside.schemas.detections import COLOR_RGB

CAPTIONS = {0.1: 172, 0.03: 207}
"""Thresholds that the captions of figures 9.5 and 9.6 give for their alpha."""
_IMAGES, _PIXELS, _SEED = 12, 20_000, 1
"""Images with white signs whose pixels are taken, pixels of either kind at most, and which of them."""


def neyman_pearson_figures(drive: Drive) -> Iterator[Figure]:
    """Figures 9.1 to 9.6."""
    images = drive.images(_frames_with(drive, "white"))
    on, off = _pixels(drive, images)
    reds = (on[:, 0], off[:, 0])
    enough = all(len(np.unique(values)) > 1 for values in reds)
    densities = [("report", report_densities())]
    if enough:
        densities.append(("this drive", fitted_densities(*reds)))
    ours = f"red of {len(on)} pixels of white signs and {len(off)} beside them, in {len(images)} images"
    if not enough:
        ours = "no labelled white sign: the report's own densities only"
    yield _densities(densities, ours)
    yield _ratio(densities)
    yield _power(densities)
    frame = max(images, default=None, key=lambda f: _white_area(drive, f))
    for number, alpha in (("9.4", None), ("9.5", 0.1), ("9.6", 0.03)):
        yield _image(images, frame, number, alpha, on, off)


def roc_figures(drive: Drive) -> Iterator[Figure]:
    """Figure 10.1 for each colour, and the report's claim for green."""
    samples = drive.samples["color"].known()
    title = "ROC of the colour classifier"
    report = (
        "50 labelled images; green: all signs found while 1.8 % of the segments of no sign pass"
    )
    plot = Plot((0, 1), (0, 1), ("false positive rate (10.2)", "true positive rate (10.1)"))
    rows: list[tuple[str, ...]] = [
        (
            "colour",
            "signs",
            "others",
            "area",
            "at the shipped distance: TPR",
            "FPR",
            "FPR where all signs pass",
        )
    ]
    green = ""
    model = drive.models.color_classes
    for name in () if model is None else (one.name for one in model.classes):
        one = _curve_of(drive, samples, name)
        if one is None:
            continue
        fpr, tpr, words, full = one
        ink = "#{:02x}{:02x}{:02x}".format(*(max(v - 30, 0) for v in COLOR_RGB[name]))
        plot.line(
            np.column_stack([fpr, tpr]),
            ink if name != "white" else "#161b22",
            name.replace("_", " "),
        )
        rows.append((name.replace("_", " "), *words, full))
        if name == "green":
            green = f"green: all signs pass with FPR {full}"
    if len(rows) == 1:
        yield Figure(
            "10.1",
            title,
            report,
            needs="labelled signs of a colour that the report's classifier has",
        )
        return
    yield Figure(
        "10.1",
        title,
        report,
        green or "no labelled green sign",
        (plot.picture(),),
        table=tuple(rows),
    )
    yield _confusion(samples)


def _curve_of(
    drive: Drive, samples: ClassifierSamples, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, ...], str] | None:
    """Rates and words of one colour: its signs against all that is no sign."""
    model = drive.models.color_classes
    if model is None:
        return None
    column = [one.name for one in model.classes].index(name)
    wanted = (samples.label == ON) & (samples.kind == name)
    rows = np.flatnonzero(wanted | (samples.label == OFF))
    chosen = samples.select(rows)
    distance = model.distances(chosen.values)[:, column]
    group, _ = resampled_groups(chosen.drive, chosen.frame)
    on = wanted[rows]
    curve = roc_curve(Scores(distance, on, chosen.count, group, accept_below=True))
    if curve is None:
        return None
    limit = model.classes[column].threshold
    accepted = distance <= limit
    largest = float(distance[on].max())
    passing = int((distance[~on] <= largest).sum())
    words = (
        str(int(on.sum())),
        str(int((~on).sum())),
        f"{curve.area:.4f}",
        share_words(int(accepted[on].sum()), int(on.sum())),
        share_words(int(accepted[~on].sum()), int((~on).sum())),
    )
    return curve.fpr, curve.tpr, words, share_words(passing, int((~on).sum()))


def _confusion(samples: ClassifierSamples) -> Figure:
    kinds = [str(k) for k in np.unique(samples.kind[samples.label == ON]) if k != NO_CLASS]
    named = [str(n) for n in np.unique(samples.named) if n != NO_CLASS]
    rows = [("labelled as", *(n.replace("_", " ") for n in named), "refused")]
    for kind in [*kinds, NO_CLASS]:
        own = samples.label == OFF if kind == NO_CLASS else samples.kind == kind
        counts = [int((own & (samples.named == n)).sum()) for n in (*named, NO_CLASS)]
        rows.append(((kind or "no sign").replace("_", " "), *map(str, counts)))
    right = sum(int(((samples.kind == k) & (samples.named == k)).sum()) for k in kinds)
    total = int((samples.label == ON).sum())
    return Figure(
        "10.1 (matrix)",
        "confusion matrix of the colour classifier",
        "one matrix of a colour, with TP, FN, FP and TN",
        f"segments on signs that are named right: {share_words(right, total)}",
        table=tuple(rows),
    )


def _frames_with(drive: Drive, color: str) -> list[int]:
    """Frames with a face of a colour, those of the largest faces first."""
    faces = drive.faces
    used = faces.example & np.isin(faces.frame, list(drive.frames))
    rows = [row for row in np.flatnonzero(used) if faces.color[row] == color]
    rows.sort(key=lambda row: -float(np.prod(faces.box[row, 2:] - faces.box[row, :2])))
    return list(dict.fromkeys(int(faces.frame[row]) for row in rows))[:_IMAGES]


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
            inside[
                max(round(y0 + dy), 0) : round(y1 - dy), max(round(x0 + dx), 0) : round(x1 - dx)
            ] = True
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
            most = _PIXELS // _IMAGES
            kept.append(pixels[draw.permutation(len(pixels))[:most]])
    return np.concatenate(found[0]), np.concatenate(found[1])


def _white_area(drive: Drive, frame: int) -> float:
    faces = drive.faces
    own = [r for r in np.flatnonzero(faces.frame == frame) if faces.color[r] == "white"]
    return sum(float(np.prod(faces.box[r, 2:] - faces.box[r, :2])) for r in own)


def _densities(densities: Sequence[tuple[str, Densities]], ours: str) -> Figure:
    top = max(float(max(d.off.max(), d.on.max())) for _, d in densities)
    plot = Plot((0, 255), (0, 1.1 * top), ("red", "density"))
    for i, (name, d) in enumerate(densities):
        plot.line(
            np.column_stack([d.values, d.off]), INKS[2 * i], f"{name}: no sign, p0", dashed=i > 0
        )
        plot.line(
            np.column_stack([d.values, d.on]),
            INKS[2 * i + 1],
            f"{name}: white sign, p1",
            dashed=i > 0,
        )
    return Figure(
        "9.1",
        "densities of the red of white signs and of the rest",
        "p0 = N(118.337, 1489) on 20 to 252.6; p1 = 4.211e-9 exp(y / sqrt 235) on 136.2 to 253.8; 50 images",
        ours,
        (plot.picture(),),
    )


def _ratio(densities: Sequence[tuple[str, Densities]]) -> Figure:
    plot = Plot((0, 255), (-6, 6), ("red", "log10 of the likelihood ratio"))
    words = []
    for i, (name, d) in enumerate(densities):
        with np.errstate(divide="ignore"):
            ratio = np.log10(d.likelihood_ratio)
        ratio[~np.isfinite(ratio)] = np.nan
        plot.line(np.column_stack([d.values, ratio]), INKS[i], name)
        inside = (d.values >= 0) & (d.values <= 255)
        below = np.flatnonzero(inside & (d.likelihood_ratio < 1) & (d.off > 0))
        if len(below) and below[-1] + 1 < len(d.values):
            words.append(f"{name}: L is above 1 from {d.values[below[-1] + 1]:.1f} on")
    return Figure(
        "9.2",
        "likelihood ratio",
        "L = p1 / p0 rises with the red",
        "; ".join(words),
        (plot.picture(),),
    )


def _power(densities: Sequence[tuple[str, Densities]]) -> Figure:
    alphas = np.concatenate([np.linspace(0, 0.1, 41), np.linspace(0.11, 0.99, 45)])
    plot = Plot((0, 1), (0, 1), ("false-alarm rate alpha", "power"))
    equation = [(a, report_power(report_threshold(float(a)))) for a in alphas]
    plot.line(equation, INKS[0], "report, eq. 9.7 and 9.8")
    rows: list[tuple[str, ...]] = [
        (
            "alpha",
            "report, eq. 9.7: red from",
            "power by 9.8",
            "captions",
            "this drive: red from",
            "power",
        )
    ]
    own = densities[1][1] if len(densities) > 1 else None
    if own is not None:
        tests = [most_powerful_test(own, float(a)) for a in alphas]
        plot.line([(t.false_alarm, t.power) for t in tests], INKS[1], "this drive")
    for alpha in (0.1, 0.05, 0.03, 0.01):
        y = report_threshold(alpha)
        cells = [f"{alpha:g}", f"{y:.2f}", f"{report_power(y):.4f}", str(CAPTIONS.get(alpha, ""))]
        if own is not None:
            test = most_powerful_test(own, alpha)
            cells += [
                "several ranges" if test.threshold is None else f"{test.threshold:.1f}",
                f"{test.power:.4f}",
            ]
        rows.append((*cells, *[""] * (6 - len(cells))))
    return Figure(
        "9.3",
        "power of the most powerful test",
        "its curve for white signs; the captions of figures 9.5 and 9.6 say 172 at alpha 0.1 and 207 at 0.03",
        "the equations give 167.73 and 190.77: 172 and 207 are the thresholds of alpha 0.082 and 0.0105",
        (plot.picture(),),
        table=tuple(rows),
    )


def _image(
    images: dict[int, NDArray[np.uint8]],
    frame: int | None,
    number: str,
    alpha: float | None,
    on: NDArray[np.float64],
    off: NDArray[np.float64],
) -> Figure:
    title = "the image" if alpha is None else f"decided with alpha {alpha:g}"
    said = "white signs" if alpha is None else f"red, green and blue above {CAPTIONS[alpha]}"
    if frame is None:
        return Figure(number, title, said, needs="a labelled white sign")
    rgb = images[frame]
    if alpha is None:
        return Figure(number, title, said, f"frame {frame}", (photo(rgb, scale=0.5),))
    y = report_threshold(alpha)
    shown = rgb.copy()
    shown[~(rgb > y).all(axis=2)] = 0
    words = [
        f"{name}: {share_words(int((pixels >= y).sum()), len(pixels))} by red, "
        f"{share_words(int(every.sum()), len(pixels))} by all three colours"
        for name, pixels, every in (
            ("of pixels of white signs pass", on[:, 0], (on >= y).all(axis=1)),
            ("of other pixels", off[:, 0], (off >= y).all(axis=1)),
        )
    ]
    return Figure(
        number,
        title,
        f"{said}; alpha is that of red alone",
        f"threshold {y:.2f} by eq. 9.7; {'; '.join(words)}",
        (photo(shown, f"frame {frame}, what passes", scale=0.5),),
    )
