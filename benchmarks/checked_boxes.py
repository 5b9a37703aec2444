"""Signs that the labels of real drives leave out, as boxes that were checked by eye.

Learning has its own file of such boxes; `checked_boxes.json` has the boxes of drives that are for tests only. They were
checked because a network or a run had found them, so they say nothing about recall.
"""

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

LEARNED = Path(__file__).parents[1] / "training" / "checked_boxes.parquet"
OF_TESTS = Path(__file__).with_suffix(".json")


def with_checked_boxes(labels: dict[str, Any], drive: str) -> dict[str, Any]:
    """The labels of a drive with these signs added, none of them wanted."""
    own = {known["id"] for known in labels["signs"]}
    learned = pq.read_table(LEARNED, filters=[("source", "=", drive)]).to_pylist()
    frames = {row["image"]: [[*sign.values()] for sign in row["signs"]] for row in learned}
    of_tests = json.loads(OF_TESTS.read_text(encoding="utf-8")).get(drive, {})
    frames |= {frame: boxes.get("signs", []) for frame, boxes in of_tests.items()}
    added = [
        {
            "id": f"{frame}/{k}",
            "what": "a sign without a label",
            "facing": "front",
            "wanted": False,
            "boxes": [{"i": int(frame), "box": sign[:4]}],
        }
        for frame, signs in frames.items()
        for k, sign in enumerate(signs)
    ]
    assert own.isdisjoint(one["id"] for one in added)
    return {**labels, "signs": [*labels["signs"], *added]}
