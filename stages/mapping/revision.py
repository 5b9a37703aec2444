"""Later stages change their mind about a place: its candidates follow, in this frame and those still to come."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from wayside.schemas.detections import verdict_code
from wayside.schemas.landmarks import Landmark, TrackedFrame


class Revision:
    """Verdicts that replace `sign`, by track, until the last frame of the track has gone by."""

    def __init__(self) -> None:
        self._changed: dict[int, tuple[str, int]] = {}

    def apply(self, settled: TrackedFrame, places: Sequence[Landmark]) -> TrackedFrame:
        """The frame with those places instead of its own, its candidates after them."""
        for place in places:
            if place.verdict != "sign":
                last = max(view.frame for view in place.views)
                self._changed[place.track_id] = (place.verdict, last)
        index = settled.frame.index
        verdict = settled.candidates.verdict.copy()
        for track, (name, last) in list(self._changed.items()):
            mine = (settled.track_id == track) & (verdict == verdict_code("sign"))
            verdict[mine] = verdict_code(name)
            if last <= index:
                del self._changed[track]
        table = replace(settled.candidates, verdict=verdict)
        return replace(settled, candidates=table, places=tuple(places))
