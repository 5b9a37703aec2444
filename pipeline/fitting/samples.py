"""Images with labels, from logs and folders, and the samples that classifiers of a fit get from them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.labels.read import FrameLabels, LogImages, labels_by_frame
from wayside.pipeline.learning.asked import ClassifierSamples, gather_samples
from wayside.pipeline.learning.fits import Samples, sides
from wayside.pipeline.learning.gates import OVERHEAD_M
from wayside.pipeline.learning.labelled import ANY_SPACING_M, OFF, ON, Faces, labelled_faces
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.image_headers import read_exif, refuse_turned
from wayside.pipeline.reading.image_order import image_files, natural_key
from wayside.schemas.detections import COLORS
from wayside.schemas.errors import InputError
from wayside.schemas.frame import USED, Frame, Image
from wayside.schemas.labels import SIGN, Labels
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import ReadSettings, Settings
from wayside.stages.classifiers import nearest_class
from wayside.stages.geometry import iou_matrix
from wayside.stages.imaging import decode
from wayside.stages.kernels import Array, Numbers
from wayside.stages.report import color_features, fourier_descriptors, outlines_of
from wayside.stages.segmentation import segment

STRETCHES = 10
"""Parts of the road, with as many labelled images each, that are held out one after the other (Kohavi 1995)."""


@dataclass(frozen=True, slots=True)
class LabelledDrive:
    """A log, or a folder of images in their natural order, with labels.

    `faces`: what is labelled, with numbers of signs that no other drive has. `stretch`: number of the stretch of each
    labelled frame. `fold`: that of all its stretches where whole drives are held out, else None.
    """

    path: Path
    is_log: bool
    faces: Faces
    stretch: Mapping[int, int]
    fold: int | None

    @property
    def name(self) -> str:
        """Stem of the log, name of the folder."""
        return self.path.stem if self.is_log else self.path.resolve().name

    @property
    def boxes_of_signs(self) -> str:
        """How many faces are labelled, and of how many signs, in words."""
        return (
            f"{counted(len(self.faces.sign), 'box', 'boxes')} of "
            f"{counted(len(set(self.faces.sign.tolist())), 'sign')}"
        )

    def images(self, settings: ReadSettings) -> Iterator[Image]:
        """The labelled images that the settings let take part, decoded, in order."""
        if not self.is_log:
            yield from _folder_images(self.path, self.stretch)
            return
        frames = read_frames(self.path, _every_image(settings), ReadReport())
        yield from decode(frame for frame in frames if frame.index in self.stretch and frame.used)

    def stretch_of(self, frames: Numbers, sign: Numbers) -> Numbers:
        """Stretch (n,) of samples in `frames` (n,): that in which most labels of their sign (n,) are, if it is one.

        Frames between labelled ones belong to the nearest of these.
        """
        labelled = np.array(sorted(self.stretch), np.int64)
        nearest = np.abs(frames[:, None] - labelled).argmin(axis=1)
        found = np.array([self.stretch[frame] for frame in labelled[nearest].tolist()], np.int64)
        for one in np.unique(sign[sign >= 0]):
            own = self.faces.frame[self.faces.sign == one].tolist()
            found[sign == one] = np.bincount([self.stretch[frame] for frame in own]).argmax()
        return found


def labelled_drives(
    labels: Sequence[Labels], images: Sequence[Path], settings: ReadSettings, *, complete: bool
) -> list[LabelledDrive]:
    """The images with labels: whole drives are held out where there are several, else stretches of one.

    `labels`: one for all, or one for each of `images` (logs and folders), in their order. `complete`: take every
    labelled image for one with every sign labelled. Raises InputError for a log or folder without a labelled image.
    """
    given = list(labels) if len(labels) == len(images) else [labels[0]] * len(images)
    found = [
        (path, *_by_frame(own, path, settings)) for own, path in zip(given, images, strict=True)
    ]
    drives: list[LabelledDrive] = []
    total = sum(len(_labelled(own)) for _, _, own in found)
    first_sign = first_stretch = 0
    for number, (path, is_log, own) in enumerate(found):
        frames = _labelled(own)
        if complete:
            own = replace(own, complete=frozenset(frames))
        parts = max(1, min(round(STRETCHES * len(frames) / total), len(frames) // 2))
        stretch = {
            frame: first_stretch + min(parts - 1, place * parts // len(frames))
            for place, frame in enumerate(frames)
        }
        faces = labelled_faces(own)
        faces = replace(faces, sign=faces.sign + first_sign)
        fold = number if len(found) > 1 else None
        drives.append(LabelledDrive(path, is_log, faces, stretch, fold))
        first_stretch += parts
        first_sign += len(faces.sign)
    return drives


def _labelled(labels: FrameLabels) -> list[int]:
    return sorted({*labels.labels, *labels.complete})


def _by_frame(labels: Labels, path: Path, settings: ReadSettings) -> tuple[bool, FrameLabels]:
    """Whether a path is a log, and its labels by frame: those of the images that take part."""
    if path.is_dir():
        files = _files(path)
        if not files:
            raise InputError(f"{path}: the folder holds no JPEG or PNG images")
        listed = (*(one.image for one in labels.labels), *labels.complete)
        known_names = {image.image_name for image in listed}
        below = [(file, file.relative_to(path).as_posix()) for file in files]
        # labels name a file by its path below the folder, or by its name alone
        names = {k: one if one in known_names else file.name for k, (file, one) in enumerate(below)}
        found = labels_by_frame(labels, path.resolve().name, {k: -1 - k for k in names}, names)
        used = set(names)
    else:
        known = LogImages.of(path, _every_image(settings))
        used = set(known.used)
        found = labels_by_frame(labels, path.stem, known.times_ns, known.names)
    kept = {frame: own for frame, own in found.labels.items() if frame in used}
    found = replace(found, labels=kept, complete=found.complete & used)
    if not _labelled(found):
        lost = ", ".join(f"{count} {reason}" for reason, count in found.left_out.items())
        raise InputError(
            f"{path}: no label belongs to its images ({lost or 'outside the part that is read'}). Give the labels of "
            "this log or folder; see docs/labels.md."
        )
    return path.is_file(), found


def _every_image(settings: ReadSettings) -> ReadSettings:
    return replace(settings, thin_m=0.0, every=1, spacing_m=settings.spacing_m or ANY_SPACING_M)


def _files(folder: Path) -> list[Path]:
    """Images of a folder and of the folders in it, in their natural order."""
    folders = [folder, *sorted(part for part in folder.rglob("*") if part.is_dir())]
    return sorted(image_files(folders), key=natural_key)


def _folder_images(folder: Path, wanted: Mapping[int, int]) -> Iterator[Image]:
    for index, file in enumerate(_files(folder)):
        if index not in wanted:
            continue
        rgb = cv2.imread(str(file), cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
        if rgb is None:
            raise InputError(f"{file}: the image cannot be read. Leave it out.")
        refuse_turned(str(file), read_exif(file.read_bytes()))
        pixels = np.ascontiguousarray(rgb, np.uint8)
        height, width = pixels.shape[:2]
        frame = Frame(index, index, None, USED, "", b"", None, width, height)
        yield Image(frame, pixels, np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), np.uint8))


MOST_OTHERS = 100
"""Most regions off faces that are taken from an image: 50 images then give a rate of 0.01 by 50 samples."""

WHOLE = 0.8
"""Overlap (IoU) with its face from which a region has the outline of the face: half a face has another shape."""


@dataclass(frozen=True, slots=True)
class Gathered:
    """Samples of one classifier, and how many labelled faces there are and have a region on them."""

    samples: Samples
    faces: int
    met: int


def region_samples(
    drives: Sequence[LabelledDrive], settings: Settings, accepting: GaussianModel | None = None
) -> Gathered:
    """Samples for the colour classifier, or, with the `accepting` colour model, for the shape classifier.

    Colour: mean RGB of regions, on labelled faces and off them. Shape: Fourier descriptors of outlines that cover their
    face, and of those off all faces whose colour is accepted. An image gives at most `MOST_OTHERS` off faces, spread.
    """
    parts, faces, met = [], 0, 0
    for drive in drives:
        names = drive.faces.color if accepting is None else drive.faces.shape
        seen: set[int] = set()
        images = (image for image in drive.images(settings.read) if image.rgb is not None)
        for item in segment(images, settings.segment, settings.gate):
            regions = item.regions
            label, face = drive.faces.label_regions(item.frame.index, regions.box)
            kind = np.append(names, "")[face]
            off = label == OFF
            on = np.flatnonzero((label == ON) & (kind != ""))
            if accepting is not None:
                features = color_features(regions.rgb, accepting.space)
                off &= nearest_class(features, accepting, COLORS)[2] >= accepting.threshold
                on = on[iou_matrix(regions.box[on], drive.faces.box[face[on]]).diagonal() >= WHOLE]
            rows = np.union1d(spread(np.flatnonzero(off), MOST_OTHERS), on)
            values = (
                regions.rgb[rows].astype(np.float64)
                if accepting is None
                else fourier_descriptors(outlines_of(item, regions.select(rows)))
            )
            known = np.isfinite(values).all(axis=1)
            rows, values = rows[known], values[known]
            sign = np.append(drive.faces.sign, -1)[face[rows]]
            frames = np.full(len(rows), item.frame.index, np.int64)
            parts.append(_samples(drive, frames, values, kind[rows], sign))
            seen.update(face[rows][face[rows] >= 0].tolist())
        faces, met = faces + int((drive.faces.example & (names != "")).sum()), met + len(seen)
    if not parts:
        raise InputError("no labelled image can be decoded. Check the images that the labels name.")
    return Gathered(Samples.joined(parts), faces, met)


def run_drives(
    drives: Iterable[LabelledDrive], settings: Settings, models: Models
) -> list[tuple[LabelledDrive, Mapping[str, ClassifierSamples]]]:
    """Run the logs among the drives: what each classifier was asked there. Raises InputError without one."""
    logs = [drive for drive in drives if drive.is_log]
    if not logs:
        raise InputError(
            "folders of images have no landmarks, which are seen in several images in order. Make a log of them with "
            "`wayside import`."
        )
    return [(one, gather_samples(one.path, one.faces, settings, models)) for one in logs]


def landmark_samples(
    runs: Iterable[tuple[LabelledDrive, Mapping[str, ClassifierSamples]]], classifier: str
) -> Samples:
    """The landmarks that a classifier was given, those of signs as class `SIGN`; may have no rows."""
    parts = []
    unnamed = -1
    for drive, asked in runs:
        if classifier not in asked:
            continue
        own = asked[classifier].known()
        on = own.label == ON
        sign = np.full(len(own), -1, np.int64)
        for row in np.flatnonzero(on):
            sign[row] = drive.faces.sign_at(int(own.frame[row]), own.box[row].tolist())
        part = _samples(drive, own.frame.astype(np.int64), own.values, np.where(on, SIGN, ""), sign)
        # a landmark whose best view is in no labelled image is a sign of its own
        missing = on & (sign < 0)
        sign[missing] = unnamed - 1 - np.arange(missing.sum())
        unnamed -= int(missing.sum())
        parts.append(part)
    none = np.zeros(0, np.int64)
    empty = Samples(np.zeros((0, 1)), np.zeros(0, np.str_), none, none, none)
    return Samples.joined(parts) if parts else empty


def by_side(samples: Samples) -> Samples:
    """Places (n, 2) of signs as the classes of the location model: `right` and `left` of the path, `overhead`."""
    if not len(samples):
        return samples
    side = sides(samples.values, OVERHEAD_M)
    return replace(samples, kind=np.where(samples.kind == "", "", side))


def spread(rows: Numbers, most: int) -> Numbers:
    """At most so many of the rows, evenly spread among them."""
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def _samples(
    drive: LabelledDrive, frames: Numbers, values: Array, kind: NDArray[np.str_], sign: Numbers
) -> Samples:
    stretch = drive.stretch_of(frames, sign)
    fold = stretch if drive.fold is None else np.full_like(stretch, drive.fold)
    return Samples(values, kind, sign, stretch, fold)
