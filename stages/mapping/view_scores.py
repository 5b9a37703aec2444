"""The score of a landmark by those of its views, where these are of a detector that no landmark classifier knows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from wayside.schemas.landmarks import TrackedFrame
from wayside.stages.mapping.landmark_evidence import FEATURES

BEST = FEATURES.index("score_best")


def score_by_views(frames: Iterator[TrackedFrame]) -> Iterator[TrackedFrame]:
    """Give each landmark the mean log odds of its three best views.

    How many views agree is no part of it: views of one object are alike, and a detector that takes a board for a sign
    does so in all of them.
    """
    for frame in frames:
        scored = tuple(replace(one, score=one.features[BEST]) for one in frame.landmarks)
        yield replace(frame, landmarks=scored)
