"""The side of the road that traffic keeps to, by where the signs of the drive stand.

Where signs stand is learned from drives on the right: most near the right edge of the road, some beyond its left one.
Where traffic keeps left it is the other way round.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from wayside.schemas.landmarks import Landmark
from wayside.stages.mapping.landmark_evidence import FEATURES, LandmarkClassifier

TERM = "place"


def left_traffic_ratio(landmarks: Iterable[Landmark], on_right: LandmarkClassifier) -> float:
    """Log-likelihood ratio of traffic on the left against the right, by the places of landmarks.

    Those count that are seen from the front and signs by all evidence but their place: else it would say which signs
    are asked. on_right: classifies faces on drives where traffic keeps right.
    """
    model, location = on_right.model, on_right.location
    if model is None or location is None or TERM not in model.terms:
        return 0.0
    ratio, sides = 0.0, (location.mirrored(), location)
    for one in landmarks:
        place = dict(one.evidence).get(TERM, 0.0)
        if not one.features or one.back or one.verdict != "sign" or one.score < place:
            continue
        where = np.array([[one.right_m, one.above_m]])
        named = dict(zip(FEATURES, one.features, strict=True))
        left, right = (
            model.ratios(named | {"place_sigmas": float(side.distances(where).min())})[TERM]
            for side in sides
        )
        ratio += left - right
    return ratio


def mirrored(classifier: LandmarkClassifier) -> LandmarkClassifier:
    """The classifier for drives where traffic keeps to the other side."""
    location = classifier.location
    return classifier if location is None else replace(classifier, location=location.mirrored())
