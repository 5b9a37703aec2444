"""Counts of the boxes of another detector: read, left out by reason, and views of signs."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wayside.schemas.detections import SOURCES, verdict_code
from wayside.schemas.detectors import BoxFile, DetectorFile
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.stages.detection import boxes_of, by_image_id, number_of

REASONS = {
    "not_read": "cannot be read",
    "not_finite": "have a coordinate or score that is not a number",
    "no_area": "have no width or height",
    "other_class": "are of classes that are not signs",
    "below_score": "have a score below candidates.external_score",
    "outside_image": "lie outside their image",
    "unused_image": "are of images that were not used",
    "not_in_log": "are of images that the log does not hold",
}
"""Why boxes are left out, as the end of a sentence that starts with their number."""
EXPECTED = ("other_class", "below_score", "unused_image")
"""Reasons that are no fault of the file."""


class BoxAccounting:
    """Counts the boxes of one run, frame by frame."""

    def __init__(self, source: DetectorFile | BoxFile) -> None:
        self._source = source
        self._file = source if isinstance(source, BoxFile) else None
        self._given = 0 if self._file is None else self._file.rows
        self._left_out = Counter({} if self._file is None else self._file.left_out)
        self._unseen = set() if self._file is None else set(self._file.boxes)
        self._candidates = self._of_signs = 0

    def take(self, settled: TrackedFrame) -> None:
        """Count the boxes of a frame whose candidates are decided."""
        table, unused = settled.candidates, settled.motion is None
        own = table.regions.source == SOURCES.index("external")
        self._candidates += int(own.sum())
        self._of_signs += int((own & (table.verdict == verdict_code("sign"))).sum())
        if self._file is None:
            self._given += settled.region_count
            reason = "unused_image" if unused else "other_class"
            self._left_out[reason] += settled.region_count - len(table)
            return
        number = number_of(self._file, settled.frame)
        names, met = self._file.names, number in self._file.boxes and number not in self._unseen
        if names and met and number is not None:
            raise InputError(
                f"models.detections: two images of the log have the name {names[number]} of "
                f"{self._file.path}; give the frame of each box (docs/detectors.md)"
            )
        self._unseen -= {number}
        given = len(boxes_of(self._file, settled.frame))
        self._left_out["unused_image" if unused else "outside_image"] += given - len(table)

    @property
    def counts(self) -> dict[str, Any]:
        """The entry of `run.json`: boxes that came in, left out by reason, candidates, views of signs."""
        left_out = self._left_out.copy()
        if self._file is not None:
            left_out["not_in_log"] += sum(len(self._file.boxes[image]) for image in self._unseen)
        return {
            "given": self._given,
            "left_out": {name: left_out[name] for name in REASONS if left_out[name]},
            "candidates": self._candidates,
            "of_signs": self._of_signs,
        }

    def require_known(self) -> None:
        """Refuse a file none of whose boxes is of an image of the log (InputError)."""
        if self._file is None or not self._file.boxes or self._unseen != set(self._file.boxes):
            return
        known = self._file.names[:3] or [str(number) for number in sorted(self._file.boxes)[:3]]
        raise InputError(
            f"models.detections: no {self._file.key} in {self._file.path} ({', '.join(known)} ...) belongs to an image "
            "of the log. The table frames.parquet of a run lists the frames and their times."
        )

    @property
    def notes(self) -> list[str]:
        """What is wrong with the boxes, in words."""
        given, left_out = self._given, self.counts["left_out"]
        why = {"not_read": f" ({self._file.fault})"} if self._file is not None else {}
        faults = [
            f"{count} of {given} boxes {REASONS[name]}{why.get(name, '')}"
            for name, count in left_out.items()
            if name not in EXPECTED
        ]
        if not given:
            faults.append("it has no boxes")
        elif left_out.get("other_class", 0) == given:
            faults.append(
                f"all {given} boxes are of classes that the class map does not name (models.classes)"
            )
        if self._source.signs is None:
            faults.append("no class map: boxes of every class count as signs (models.classes)")
        return faults

    @property
    def source(self) -> dict[str, Any]:
        """The entry of `run.json` on where the boxes are from."""
        source, signs = self._source, self._source.signs
        classes = None if signs is None else {str(k): asdict(one) for k, one in signs.items()}
        if isinstance(source, BoxFile):
            about = {"file": Path(source.path).name, "sha256": source.sha256}
            return about | {"images_by": source.key, "classes": classes}
        size = source.input_size
        return {
            "file": Path(source.onnx.path).name,
            "sha256": source.onnx.sha256,
            "format": source.format,
            "input": None if size is None else [size[1], size[0]],
            "classes": classes,
        }

    @property
    def words(self) -> str:
        """One line for a person."""
        counts = self.counts
        kind = "boxes" if self._file is not None else f"detector, {self.source['format']}"
        left_out = "".join(
            f", {count} {reason.replace('_', ' ')}" for reason, count in counts["left_out"].items()
        )
        return (
            f"{kind} of {self.source['file']}: {counts['given']} boxes read, {counts['candidates']} are candidates, "
            f"{counts['of_signs']} are views of signs{left_out}"
        )


def paired(boxes: BoxFile, first: Frame, held: int) -> list[str]:
    """Notes on boxes for a log of so many images, of which this is the first.

    Stray numbers are counted later where the file itself calls them frames. Raises InputError where `image_id` is no
    number of a frame, frames count from 1, or names say only the order of the images, and there are more or fewer.
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
            f"is not a frame of the log: its {held} images are the frames 0 to {held - 1}. Count from 0. For a log of "
            "`wayside import`, file_name (image_name in Parquet) does as well (docs/detectors.md)."
        )
    if by_id and least == 1:
        return [
            "image_id begins at 1 and is taken for the frame, which begins at 0; if it counts images from 1, give "
            "file_name with each result"
        ]
    return []
