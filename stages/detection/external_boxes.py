"""Boxes of another detector as candidates: it takes the place of proposals and box classifier.

Its boxes are the detections and its scores theirs. Its classes give colour and shape where they name them; otherwise
the box network does.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import PurePosixPath

import numpy as np

from wayside.schemas.detections import NONE, Candidates, Detections, Regions
from wayside.schemas.detectors import BoxFile, ExternalBoxes
from wayside.schemas.frame import Camera, Frame, Image
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection.box_network import BoxNetwork
from wayside.stages.detection.detector import SAME_FACE_IOU, with_names, with_scores
from wayside.stages.detection.onnx_detector import OnnxDetector
from wayside.stages.detection.proposals import regions_of
from wayside.stages.segmentation import unsegmented


def detect_externally(
    items: Iterator[Image],
    *,
    source: OnnxDetector | BoxFile,
    settings: CandidateSettings,
    network: BoxNetwork,
) -> Iterator[Detections]:
    """The boxes of a detector or of a file as the candidates of each image, in order.

    Images that are not used have no candidates. Of boxes that overlap the best stays (`overlap`), of all of them the
    best `settings.keep` (`score`). `network`: the box network, which names what the classes of the boxes do not.

    Raises InputError where the detector's outputs are not understood.
    """
    for item in items:
        segmentation, camera = unsegmented(item), item.frame.camera
        if item.rgb is None or camera is None:
            yield Detections(segmentation, Candidates.of(segmentation.regions))
            continue
        if isinstance(source, BoxFile):
            found = inside_image(boxes_of(source, item.frame), camera)
        else:
            found = source.boxes(item.rgb, settings.external_score, SAME_FACE_IOU)
        segmentation = replace(
            segmentation,
            regions=regions_of(found.box, found.shape, item.rgb, "external"),
            region_count=found.found,
        )
        candidates = classified(found, segmentation.regions, item, settings.keep, network)
        yield Detections(segmentation, candidates)


def boxes_of(source: BoxFile, frame: Frame) -> ExternalBoxes:
    """The boxes of a frame as the file has them."""
    number = number_of(source, frame)
    found = None if number is None else source.boxes.get(number)
    return ExternalBoxes.empty() if found is None else found


def number_of(source: BoxFile, frame: Frame) -> int | None:
    """The number that names this frame in `source.boxes`; None if no name of the file fits.

    File names of the log count, if it has them. Otherwise `image_id` counts, or the order of the names.
    """
    if by_image_id(source, frame):
        return source.ids.get(frame.index)
    if source.names and frame.name:
        known = (part for part in name_parts(frame.name) if part in source.places)
        return next((source.places[part] for part in known), None)
    if source.key == "log_time_ns":
        return frame.log_time_ns
    return frame.header_time_ns if source.key == "header_time_ns" else frame.index


def by_image_id(source: BoxFile, frame: Frame) -> bool:
    """Whether it is `image_id` that tells which boxes are of this frame."""
    return bool(source.ids) and not (source.names and frame.name)


def name_parts(name: str) -> list[str]:
    """A path, what stays of it without folders, and both without suffix; the longest first."""
    folders = name.replace("\\", "/").lower().split("/")
    whole = ["/".join(folders[start:]) for start in range(len(folders))]
    return whole + [str(PurePosixPath(one).with_suffix("")) for one in whole if one]


def places_of(names: Sequence[str]) -> dict[str, int | None]:
    """Index of each name by each of its parts; None where several names share the part."""
    places: dict[str, int | None] = {}
    for place, name in enumerate(names):
        for part in set(name_parts(name)):
            places[part] = None if part in places else place
    return places


def inside_image(found: ExternalBoxes, camera: Camera) -> ExternalBoxes:
    """Those with a part inside the image, cut at its border."""
    box = np.clip(found.box, 0, np.array([camera.width, camera.height] * 2, np.float32))
    return replace(found, box=box).select(np.flatnonzero((box[:, 2:] > box[:, :2]).all(axis=1)))


def classified(
    found: ExternalBoxes, regions: Regions, item: Image, keep: int, network: BoxNetwork
) -> Candidates:
    """Candidates of the boxes with scores, verdicts and classes: known ones are certain, else those of the network."""
    rows = np.arange(len(found))
    candidates = with_scores(Candidates.of(regions), found.score, -np.inf, keep)
    if len(found) == 0 or item.rgb is None:
        return candidates
    named = network.scores(item.rgb, regions.box)
    candidates = with_names(candidates, rows, named, grey=item.frame.grey)
    for name, known in (("color", found.color), ("shape", found.shape)):
        sure = np.flatnonzero(known != NONE)
        getattr(candidates, name)[sure] = known[sure]  # `with_names` made these columns
        likely = getattr(candidates, f"{name}_log_probability")
        likely[sure] = np.nan  # of a class that no network knows, the views vote
        learned = sure[known[sure] < likely.shape[1]]
        likely[learned] = -np.inf
        likely[learned, known[learned]] = 0.0
    return candidates
