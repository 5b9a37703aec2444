"""Settings of `wayside fit`. No run depends on them: the models that it writes say what they were fitted by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from wayside.schemas.settings.field import setting

_expert = partial(setting, expert=True)


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How many labels each model needs, and how its held-out figures and thresholds come about."""

    fewest_signs: int = _expert(
        5,
        "signs",
        "labelled signs that a class needs; one of fewer keeps its shipped form",
        origin="five found of five tell a true positive rate above 0.48 (Clopper and Pearson, 95 %), four above 0.4",
        low=2,
    )
    fewest_landmarks: int = _expert(
        10,
        "landmarks",
        "labelled landmarks, of signs and of others each, that the calibration of the confidence needs",
        origin="ten a coefficient, of which it has two, for both kinds together (Peduzzi et al. 1996)",
        low=4,
    )
    fewest_others: int = _expert(
        50,
        "samples",
        "samples of what no sign is, at least: a rate of 0.05 of fewer is that of two samples or less",
        origin="the smallest alpha that is of use is about 0.05",
        low=10,
    )
    most_others: int = _expert(
        100,
        "regions",
        "regions of an image that are no sign and are looked at, at most, evenly spread",
        origin="50 images then tell a false alarm rate of 0.01 by 50 samples",
        low=10,
    )
    stretches: int = _expert(
        10,
        "stretches",
        "parts of the road, with as many labelled images each, that are held out one after the other",
        origin="ten folds (Kohavi 1995)",
        low=3,
    )
    prior_signs: tuple[float, ...] = _expert(
        (1.0, 3.0, 10.0, 30.0),
        "signs",
        "signs that the pooled covariance of all classes counts as; the best on held-out stretches is taken",
        origin="from nearly none to far more than a class of 50 images has",
    )
    resamplings: int = _expert(
        400,
        "",
        "bootstrap resamplings of the stretches, for intervals",
        origin="an end of a 95 % interval then rests on ten",
        low=100,
    )
    slope_sigma: float = _expert(
        0.5,
        "",
        "scatter of the slope of the confidence about one, before any label is seen",
        origin="the slopes by which the shipped classifier is calibrated drive by drive scatter by less",
        low=0.01,
    )
    shift_sigma: float = _expert(
        2.0,
        "log odds",
        "scatter of the shift of the confidence about zero, before any label is seen",
        origin="a factor of seven in the share of signs among what is asked about",
        low=0.01,
    )
