"""Assemblies: panels of one support get one number; a panel measured twice is reported once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from wayside.schemas.detections import verdict_code
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.stages.mapping.verdicts import SUPPORT_M, same_panel, same_station

REMEMBER_M = 60.0
"""Stretch of path over which landmarks are compared, m: longer than the window."""


def assemble(tracked: Iterator[TrackedFrame]) -> Iterator[TrackedFrame]:
    """Refuse later landmarks of one panel (`duplicate`) and number the supports from 0, in order of appearance.

    Candidates of landmarks that were refused since they were tracked get the verdict of their landmark.

    Parameters
    ----------
    tracked
        Frames with the landmarks seen first in them.
    """
    refused: dict[int, tuple[str, int]] = {}
    recent: list[Landmark] = []
    count = 0
    for frame in tracked:
        landmarks = []
        for one in frame.landmarks:
            if one.verdict == "sign":
                if any(same_panel(one, other) for other in recent):
                    one = replace(one, verdict="duplicate")
                else:
                    near = (p.assembly for p in recent if same_support(one, p))
                    one = replace(one, assembly=next(near, count))
                    count += one.assembly == count
                    recent.append(one)
            landmarks.append(one)
        yield _revised(frame, landmarks, refused)
        if frame.motion is not None:
            passed_m = frame.motion.station_m - REMEMBER_M
            recent = [p for p in recent if p.station_m > passed_m]


def _revised(
    frame: TrackedFrame, landmarks: Sequence[Landmark], refused: dict[int, tuple[str, int]]
) -> TrackedFrame:
    """The frame with these landmarks, its candidates after those refused: verdict and last frame of each by track."""
    for landmark in landmarks:
        if landmark.verdict != "sign":
            last = max(view.frame for view in landmark.views)
            refused[landmark.track_id] = (landmark.verdict, last)
    verdict = frame.candidates.verdict.copy()
    for track, (name, last) in list(refused.items()):
        own = (frame.track_id == track) & (verdict == verdict_code("sign"))
        verdict[own] = verdict_code(name)
        if last <= frame.frame.index:
            del refused[track]
    table = replace(frame.candidates, verdict=verdict)
    return replace(frame, candidates=table, landmarks=tuple(landmarks))


def same_support(one: Landmark, other: Landmark) -> bool:
    """Whether two panels hang on one support: one above the other or side by side, without much between."""
    right, above = abs(one.right_m - other.right_m), abs(one.above_m - other.above_m)
    between = max(
        right - (one.width_m + other.width_m) / 2, above - (one.height_m + other.height_m) / 2
    )
    return bool(min(right, above) < SUPPORT_M and between < SUPPORT_M and same_station(one, other))
