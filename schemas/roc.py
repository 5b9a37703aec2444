"""Tables of the receiver operating characteristics that `wayside roc` writes."""

import pyarrow as pa

from wayside.schemas.tables import Column, Table

_TEXT, _LONG, _REAL = pa.string(), pa.int64(), pa.float64()
_SURE = False
_WHICH = (
    Column("classifier", _TEXT, "", "size, color, shape, trajectory, detector, landmark, location or confidence",
           _SURE),
    Column("class", _TEXT, "", "class of the model, term of the evidence, or `all` for the classifier as a whole",
           _SURE),
)  # fmt: skip

CURVES = Table(
    "roc",
    "A classifier and class from the strictest threshold on: each at which a sign is gained, and the one before it.",
    (
        *_WHICH,
        Column("threshold", _REAL, "", "in the unit of the classifier; infinite: accepts nothing", _SURE),
        Column("tp", _LONG, "", "signs of the class that are accepted", _SURE),
        Column("fp", _LONG, "", "others that are accepted", _SURE),
        Column("tpr", _REAL, "", "tp over all signs of the class (report eq. 10.1)", _SURE),
        Column("fpr", _REAL, "", "fp over all others (report eq. 10.2)", _SURE),
        Column("tpr_low", _REAL, "", "95 % band of tpr; null: one group of samples only"),
        Column("tpr_high", _REAL, "", "the same"),
        Column("fpr_low", _REAL, "", "95 % band of fpr"),
        Column("fpr_high", _REAL, "", "the same"),
    ),
)  # fmt: skip

CLASSIFIERS = Table(
    "classifiers",
    "One row per classifier and class.",
    (
        *_WHICH,
        Column("unit", _TEXT, "", "what its thresholds are", _SURE),
        Column("positives", _LONG, "", "signs of the class that it was asked about", _SURE),
        Column("negatives", _LONG, "", "others that it was asked about", _SURE),
        Column("area", _REAL, "", "under the curve; null: no signs, or nothing else"),
        Column("area_low", _REAL, "", "95 % interval of the area"),
        Column("area_high", _REAL, "", "the same"),
        Column("knee", _REAL, "", "threshold of the largest tpr - fpr"),
        Column("knee_low", _REAL, "", "95 % interval of that threshold"),
        Column("knee_high", _REAL, "", "the same"),
        Column("knee_tpr", _REAL, "", "tpr there"),
        Column("knee_fpr", _REAL, "", "fpr there"),
        Column("threshold", _REAL, "", "that the run used; null: none, a term of a sum"),
        Column("tpr", _REAL, "", "at the threshold that the run used"),
        Column("tpr_low", _REAL, "", "its 95 % band"),
        Column("tpr_high", _REAL, "", "the same"),
        Column("fpr", _REAL, "", "at the threshold that the run used"),
        Column("fpr_low", _REAL, "", "its 95 % band"),
        Column("fpr_high", _REAL, "", "the same"),
        Column("full_tpr_fpr", _REAL, "", "fpr at the strictest threshold that accepts every sign of the class"),
        Column("resampled", _TEXT, "", "what the bands resample: drive, or stretch of the one drive", _SURE),
        Column("groups", _LONG, "", "how many of these there are", _SURE),
    ),
)  # fmt: skip

CONFUSION = Table(
    "confusion",
    "One row per labelled class and class that a classifier gave, as the run decided.",
    (
        _WHICH[0],
        Column("labelled", _TEXT, "", "class by the labels; `none`: no sign, `sign`: of no class here", _SURE),
        Column("given", _TEXT, "", "class that it gave; `refused`, or `accepted` where it names none", _SURE),
        Column("count", _LONG, "", "samples", _SURE),
    ),
)  # fmt: skip
