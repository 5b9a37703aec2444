"""Log-likelihood ratios of the terms of evidence."""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan

import numpy as np

from wayside.schemas.models import EvidenceModel


def evidence_ratios(model: EvidenceModel, values: Mapping[str, float]) -> dict[str, float]:
    """Log-likelihood ratio of each term by values of the features; a value of nan adds nothing."""
    result = dict.fromkeys(model.terms, 0.0)
    columns = zip(model.features, model.terms, model.knots, model.curves, strict=True)
    for name, term, knots, curve in columns:
        if not isnan(values[name]):
            result[term] += float(np.interp(values[name], knots, curve))
    return result
