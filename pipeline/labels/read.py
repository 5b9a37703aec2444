"""Labels of any format, and the frames of a log that they are of."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from xml.etree.ElementTree import ParseError

from wayside.pipeline.files.input_files import files_below
from wayside.pipeline.files.parsing import CONTENT_FAULTS
from wayside.pipeline.labels.class_map import read_class_map
from wayside.pipeline.labels.formats import read_voc, read_yolo
from wayside.pipeline.labels.wayside_labels import read_json, read_label_file
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.results.result import RUN_FILE
from wayside.pipeline.reviewing.entries import is_review
from wayside.pipeline.reviewing.review import required_review, review_labels
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.labels import Label, LabelledImage, Labels
from wayside.schemas.settings import ReadSettings


@dataclass(frozen=True, slots=True)
class FrameLabels:
    """Labels of one log by frame.

    `labels`: of each frame that has any. `complete`: frames in which every sign is labelled. `left_out`: labels and
    complete images that are of no frame of the log, by reason (`other_log`, `other_time`, `no_such_image`).
    """

    labels: dict[int, list[Label]]
    complete: frozenset[int]
    left_out: dict[str, int]


def read_labels(
    path: Path | str, class_map: Path | None = None, review: Sequence[Path] = ()
) -> Labels:
    """Labels from a file or folder, whose content decides the format.

    A file is our Parquet table, or JSON: marks of `wayside label`, COCO, `truth.json`, `labels.json` or `scenes.json`.
    A folder with `run.json` is a result with its review, one with XML files is VOC, any other YOLO.
    `class_map`: TOML file that says which classes of COCO, YOLO and VOC are signs, and what these look like.
    `review`: one or several files for a result. Empty: those in its folder.

    Raises InputError where the path cannot be read, has another format, or holds no label that can be used.
    Raises UsageError for a result without a review, or a review without its result, which has the boxes.
    """
    path = Path(path)
    if (path / RUN_FILE).is_file():
        return review_labels(path, required_review(path, review))
    if path.is_file() and is_review(path):
        raise UsageError(
            f"{path}: this is a review, which names signs and has no boxes. Save it in the folder of its result, and "
            "give that folder as the labels."
        )
    classes = None if class_map is None else read_class_map(class_map)
    try:
        if path.is_dir():
            xml = any(file.suffix.lower() == ".xml" for file in files_below(path))
            labels = read_voc(path, classes) if xml else read_yolo(path, classes)
        elif path.suffix.lower() == ".json":
            labels = read_json(path, classes)
        else:
            labels = read_label_file(path)
    except (OSError, ParseError, *CONTENT_FAULTS) as error:
        found = str(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
        raise InputError(
            f"{path}: these are not labels (Parquet, COCO, YOLO, VOC or the truth of a drive): {found[:200]}. See "
            "docs/labels.md."
        ) from error
    if not labels.labels and not labels.complete:
        reasons = f" that can be used: {labels.reasons}" if labels.left_out else ""
        raise InputError(f"{path}: there are no labels{reasons}. See docs/labels.md.")
    return labels


def joined(parts: Sequence[Labels]) -> Labels:
    """Labels of several files as one, in their order."""
    left_out: Counter[str] = Counter()
    for part in parts:
        left_out.update(part.left_out)
    return Labels(
        tuple(label for part in parts for label in part.labels),
        tuple(image for part in parts for image in part.complete),
        dict(left_out),
        {reason: words for part in reversed(parts) for reason, words in part.first.items()},
    )


@dataclass(frozen=True, slots=True)
class LogImages:
    """What identifies the images of a log: log time and, if known, file name by frame; and the frames in use."""

    times_ns: dict[int, int]
    names: dict[int, str]
    used: frozenset[int]

    @classmethod
    def of(cls, log: Path, settings: ReadSettings) -> Self:
        """Of the frames of a log; raises InputError where it cannot be read."""
        times, names, used = {}, {}, set()
        for frame in read_frames(log, settings, ReadReport()):
            times[frame.index] = frame.log_time_ns
            if frame.name:
                names[frame.index] = frame.name
            if frame.used:
                used.add(frame.index)
        return cls(times, names, frozenset(used))


def labels_by_frame(
    labels: Labels,
    log: str,
    log_times_ns: Mapping[int, int],
    image_names: Mapping[int, str] | None = None,
) -> FrameLabels:
    """The labels of a log by its frames.

    An image is found by its frame, its log time or its name; where several of these are known, they must be of one
    frame. A name that several images have finds none.

    `labels`: of this log and perhaps of others. `log`: stem of its file name. `log_times_ns`: log time of each frame.
    `image_names`: file name of the image of each frame; None: not known.
    """
    by_time = {time: frame for frame, time in log_times_ns.items()}
    by_name = {name: frame for frame, name in (image_names or {}).items()}
    twice = {name for name, n in Counter((image_names or {}).values()).items() if n > 1}
    left_out: Counter[str] = Counter()

    def frame_of(image: LabelledImage) -> int | None:
        if image.log not in (None, log):
            left_out["other_log"] += 1
            return None
        found: set[int | None] = set()
        if image.frame is not None:
            found.add(image.frame if image.frame in log_times_ns else None)
        if image.log_time_ns is not None:
            found.add(by_time.get(image.log_time_ns))
        if image.image_name in twice:
            left_out["name_of_several"] += 1
            return None
        if image.image_name and by_name:
            found.add(by_name.get(image.image_name))
        if len(found) == 1 and (frame := found.pop()) is not None:
            return frame
        left_out["other_time" if image.log_time_ns is not None else "no_such_image"] += 1
        return None

    kept: defaultdict[int, list[Label]] = defaultdict(list)
    for label in labels.labels:
        if (frame := frame_of(label.image)) is not None:
            kept[frame].append(label)
    complete = (frame_of(image) for image in labels.complete)
    return FrameLabels(
        dict(kept), frozenset(frame for frame in complete if frame is not None), dict(left_out)
    )
