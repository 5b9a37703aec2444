"""Signs that the labels of real drives leave out, as boxes that were looked at one by one.

Those of images that models are learned from are those that learning knows; `checked_boxes.json` has those of drives
that are for tests only. They were looked at since a network or a run had found them, so they tell nothing of recall.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

CHECKED_BOXES = Path(__file__).parents[1] / "training" / "checked_boxes.json"

OF_TESTS = Path(__file__).with_suffix(".json")


def with_checked_boxes(labels: dict[str, Any], drive: str) -> dict[str, Any]:
    """The labels of a drive with these signs beside its own, none of them wanted."""
    own = {known["id"] for known in labels["signs"]}
    added = [
        {
            "id": f"{frame}/{k}",
            "what": "a sign without a label",
            "facing": "front",
            "wanted": False,
            "boxes": [{"i": int(frame), "box": sign[:4]}],
        }
        for path in (CHECKED_BOXES, OF_TESTS)
        for frame, boxes in json.loads(path.read_text(encoding="utf-8")).get(drive, {}).items()
        for k, sign in enumerate(boxes.get("signs", ()))
    ]
    assert own.isdisjoint(one["id"] for one in added)
    return {**labels, "signs": [*labels["signs"], *added]}
