"""What became of the boxes of another detector: how many came in, were left out and why, and are views of signs."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from wayside.schemas.detections import SOURCES, verdict_code
from wayside.schemas.detectors import BoxFile, DetectorFile, ExternalBoxes
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.stages.detection import boxes_of, by_image_id, number_of

REASONS = {
    "not_read": "cannot be read",
    "not_finite": "have a coordinate or score that is no number",
    "no_area": "have no width or height",
    "other_class": "are of classes that are no signs",
    "below_score": "have a score below candidates.external_score",
    "outside_image": "lie outside their image",
    "unused_image": "are of images that were not used",
    "not_in_log": "are of images that the log does not hold",
}
"""Why boxes are left out, as the end of a sentence that starts with their number."""
EXPECTED = ("other_class", "below_score", "unused_image")
"""Reasons that are no fault of the file."""


@dataclass(frozen=True, slots=True)
class BoxReport:
    """The entry of `run.json` on the boxes of another detector: their source, counts, notes, and one line in words."""

    source: dict[str, Any]
    counts: dict[str, Any]
    notes: tuple[str, ...]
    words: str


class BoxAccounting:
    """Counts the boxes of one run, frame by frame."""

    def __init__(self, source: DetectorFile | BoxFile) -> None:
        self._source = source
        self._given = source.rows if isinstance(source, BoxFile) else 0
        self._left_out: Counter[str] = Counter()
        self._unseen: set[int] = set()
        if isinstance(source, BoxFile):
            self._left_out.update(source.left_out)
            self._unseen = set(source.boxes)
        self._candidates = self._of_signs = 0

    def take(self, settled: TrackedFrame) -> None:
        """Count the boxes of a frame whose candidates are decided."""
        table = settled.candidates
        own = table.regions.source == SOURCES.index("external")
        self._candidates += int(own.sum())
        self._of_signs += int((own & (table.verdict == verdict_code("sign"))).sum())
        frame = settled.frame
        if not isinstance(self._source, BoxFile):
            self._given += settled.region_count
            reason = "unused_image" if settled.motion is None else "other_class"
            self._left_out[reason] += settled.region_count - len(table)
            return
        boxes, names = boxes_of(self._source, frame), self._source.names
        number = number_of(self._source, frame)
        if number is not None:
            if names and number in self._source.boxes and number not in self._unseen:
                raise InputError(
                    f"models.detections: two images of the log have the name {names[number]} of {self._source.path}; "
                    "say the frame of each box (docs/detectors.md)"
                )
            self._unseen.discard(number)
        if settled.motion is None:
            self._left_out["unused_image"] += len(boxes)
        else:
            self._left_out["outside_image"] += len(boxes) - len(table)

    def counts(self) -> dict[str, Any]:
        """The entry of `run.json`: boxes that came in, left out by reason, candidates, views of signs."""
        left_out = self._left_out.copy()
        if isinstance(self._source, BoxFile):
            boxes: list[ExternalBoxes] = [self._source.boxes[number] for number in self._unseen]
            left_out["not_in_log"] += sum(len(one) for one in boxes)
        return {
            "given": self._given,
            "left_out": {name: left_out[name] for name in REASONS if left_out[name]},
            "candidates": self._candidates,
            "of_signs": self._of_signs,
        }

    def report(self) -> BoxReport:
        """All of it, after the last frame.

        Raises
        ------
        InputError
            No box of a file is of an image of the log.
        """
        counts = self.counts()
        if isinstance(self._source, BoxFile):
            require_known_boxes(self._source, counts)
        words = in_words(self._source, counts)
        return BoxReport(described(self._source), counts, tuple(self._notes(counts)), words)

    def _notes(self, counts: dict[str, Any]) -> list[str]:
        """What is amiss with the boxes, in words."""
        left_out = counts["left_out"]
        where = (
            {"not_read": f" ({self._source.fault})"} if isinstance(self._source, BoxFile) else {}
        )
        faults = [
            f"{count} of {self._given} boxes {REASONS[name]}{where.get(name, '')}"
            for name, count in left_out.items()
            if name not in EXPECTED
        ]
        if not self._given:
            faults.append("no box came in")
        elif left_out.get("other_class", 0) == self._given:
            faults.append(
                f"all {self._given} boxes are of classes that the class map does not name (models.classes)"
            )
        if self._source.signs is None:
            faults.append("no class map: boxes of every class count as signs (models.classes)")
        return faults


def described(source: DetectorFile | BoxFile) -> dict[str, Any]:
    """The entry of `run.json` on where the boxes are from."""
    signs = source.signs
    classes = None if signs is None else {str(number): asdict(one) for number, one in signs.items()}
    if isinstance(source, BoxFile):
        return {
            "file": Path(source.path).name,
            "sha256": source.sha256,
            "images_by": source.key,
            "classes": classes,
        }
    size = source.input_size
    return {
        "file": Path(source.onnx.path).name,
        "sha256": source.onnx.sha256,
        "format": source.format,
        "input": None if size is None else [size[1], size[0]],
        "classes": classes,
    }


def in_words(source: DetectorFile | BoxFile, counts: dict[str, Any]) -> str:
    """One line on the boxes for a person."""
    name = Path(source.path if isinstance(source, BoxFile) else source.onnx.path).name
    kind = "boxes" if isinstance(source, BoxFile) else f"detector, {source.format}"
    left_out = "".join(
        f", {n} {reason.replace('_', ' ')}" for reason, n in counts["left_out"].items()
    )
    return (
        f"{kind} of {name}: {counts['given']} boxes came in, {counts['candidates']} are candidates, "
        f"{counts['of_signs']} are views of signs{left_out}"
    )


def paired(boxes: BoxFile, first: Frame, held: int) -> list[str]:
    """Notes on boxes for a log of so many images, of which this is the first.

    Stray numbers are counted later where the file itself calls them frames.

    Raises
    ------
    InputError
        `image_id` is no number of a frame, frames are counted from 1, or names say only the order of the images, and
        there are more or fewer.
    """
    by_id = by_image_id(boxes, first)
    if boxes.names and not first.name and not by_id and len(boxes.names) != held:
        raise InputError(
            f"models.detections: {boxes.path} names {len(boxes.names)} images, but the log has {held}. The log does "
            "not name its images, which is why they are matched in order. Name all of them, or give the frame of "
            "each box (docs/detectors.md)."
        )
    numbers = boxes.ids if by_id else boxes.boxes if boxes.key == "frame" else ()
    least, last = min(numbers, default=0), max(numbers, default=0)
    if (by_id and not 0 <= least <= last < held) or (least > 0 and last == held):
        raise InputError(
            f"models.detections: {'image_id' if by_id else 'frame'} {last if last >= held else least} in {boxes.path} "
            f"is no frame of the log: its {held} images are the frames 0 to {held - 1}. Count from 0. For a log of "
            "`wayside import`, file_name (image_name in Parquet) does as well (docs/detectors.md)."
        )
    if by_id and least == 1:
        return [
            "image_id begins at 1 and is taken for the frame, which begins at 0; if it counts images from 1, give "
            "file_name with each result"
        ]
    return []


def require_known_boxes(source: BoxFile, counts: dict[str, Any]) -> None:
    """Refuse a file none of whose boxes is of an image of the log (InputError)."""
    lost = counts["left_out"].get("not_in_log", 0)
    usable = source.rows - sum(source.left_out.values())
    if usable and lost == usable:
        known = source.names[:3] or [str(number) for number in sorted(source.boxes)[:3]]
        raise InputError(
            f"models.detections: no {source.key} in {source.path} ({', '.join(known)} ...) belongs to an image of the "
            "log. The table frames.parquet of a run lists the frames and their times."
        )
