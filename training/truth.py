"""What drives with truth say of boxes and tracks, and what the command lines of training share."""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evaluation.rendered import camera_pose, match_distance
from wayside.pipeline.files.writing import not_written, write_file
from wayside.pipeline.learning import labelled
from wayside.pipeline.models.model_json import model_to_json
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.errors import InputError, WaysideError
from wayside.schemas.frame import Frame, Image
from wayside.schemas.landmarks import Landmark, Observation
from wayside.schemas.models import Model
from wayside.schemas.settings import ReadSettings
from wayside.stages.geometry import intersection_areas, iou_matrix
from wayside.stages.imaging import decode
from wayside.stages.kernels import Array, Bytes, Flags

PREFIX = "learn_"
"""Drives of a folder that are learned from bear this at the front of their name; the others are for measuring."""

TIGHT, INSIDE, UNION = 0.6, 0.85, 0.8
"""Overlap (IoU) from which a box is tight on a face; fraction of a box from which it lies inside one; overlap from
which a box that shows a second face as well is no example rather than a bad one."""

SHOWN, APART = 0.5, 0.3
"""Fraction of a second face in a box from which the box shows it; fraction of the smaller of two faces that both may
share: more, and one lies on the other."""

TRACK_ON, TRACK_NEAR = 0.4, 0.15
"""Median overlap (IoU) of the nearest boxes with a true face from which a landmark is that face; overlap with one
above which it may be a part of it."""

LEARN_READ = ReadSettings(thin_m=0.0, spacing_m=labelled.ANY_SPACING_M)
"""Every image."""

Boxes = NDArray[np.floating[Any]]


class View(NamedTuple):
    """A panel in an image: its sign, whether from behind, its box, and whether boxes on it are examples."""

    sign: Mapping[str, Any]
    back: bool
    box: tuple[float, float, float, float]
    example: bool = True


def command(
    doc: str | None, work: Callable[..., object], **options: tuple[str, Mapping[str, Any]]
) -> Callable[..., int]:
    """A `main(arguments)` that does `work` with options by name (flag and how argparse takes it)."""

    def main(arguments: list[str] | None = None) -> int:
        parser = argparse.ArgumentParser(
            prog=f"python -m training.{Path(sys.argv[0]).stem}",
            description=doc,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for name, (flag, taken) in options.items():
            named: dict[str, Any] = {"dest": name} if flag.startswith("-") else {}
            parser.add_argument(*flag.split(), **named, **taken)
        cv2.setNumThreads(1)
        try:
            work(**vars(parser.parse_args(arguments)))
        except WaysideError as error:
            print(f"wayside: {error}", file=sys.stderr)
            return error.exit_status
        return 0

    return main


def folder(flag: str, what: str, *, required: bool = True) -> tuple[str, dict[str, Any]]:
    """An option of a command line that is a folder."""
    return flag, {"type": Path, "required": required, "help": f"folder of {what}"}


DRIVES = folder("--drives", "rendered drives")
REAL = folder("--real", "real images, drawings and crops")
OUT = folder("-o --out", "the model files")
SEED: tuple[str, dict[str, Any]] = ("--seed", {"type": int, "default": 1})


def write_model(path: Path, model: Model) -> None:
    """Write a model over the file of an earlier one, and say so; raises OutputError where that cannot be done."""
    text = model_to_json(model)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(path, error, "a model") from error
    write_file(path, text.encode(), overwrite=True)  # models are learned again into their folder
    print(f"{path}: {len(text) / 1e3:.0f} kB; {model.provenance}", flush=True)


def processes(count: int) -> ProcessPoolExecutor:
    """So many processes for drives side by side."""
    return ProcessPoolExecutor(
        count, get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
    )


def learning_logs(folder: Path) -> list[Path]:
    """The rendered drives of a folder that are learned from, in order. Raises InputError without drives."""
    logs = sorted(folder.glob(f"{PREFIX}*.mcap"))
    if not logs:
        raise InputError(f"{folder}: there are no drives named {PREFIX}*.mcap. Render them first.")
    return logs


def frames_of(log: Path, every: int = 1) -> Iterator[Frame]:
    """Every n-th frame of a log, in order."""
    return (f for f in read_frames(log, LEARN_READ, ReadReport()) if f.index % every == 0)


def images(log: Path, every: int = 1) -> Iterator[tuple[Image, Bytes]]:
    """Every n-th image of a log that can be decoded, in order, with its pixels."""
    for image in decode(frames_of(log, every)):
        if image.rgb is not None:
            yield image, image.rgb


def read_truth(log: Path) -> dict[str, Any]:
    """Truth of a rendered drive, from the folder of its log; raises InputError for other files."""
    path = log.with_suffix(".truth.json")
    try:
        truth = json.loads(path.read_text(encoding="utf-8"))
        if not {"name", "camera", "frames", "signs"} <= truth.keys():
            raise KeyError("name, camera, frames or signs")
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise InputError(
            f"{path}: this is not the truth of a rendered drive: {type(error).__name__}: {error}. Render the drive "
            "again with masks."
        ) from error
    return dict(truth)


def views_by_frame(truth: Mapping[str, Any]) -> dict[int, list[View]]:
    """The panels that each frame of a rendered drive shows. Of a back, the visible fraction is unknown."""
    views: dict[int, list[View]] = {}
    for sign in truth["signs"]:
        for view in sign["frames"]:
            back, box = view["side"] == "back", tuple(view["box"])
            seen = back or (view["visible_fraction"] or 0.0) >= labelled.FACE_FRACTION
            example = seen and box[3] - box[1] >= labelled.FACE_PX
            views.setdefault(view["frame"], []).append(View(sign, back, box, example))
    return views


def sign_positions(truth: Mapping[str, Any]) -> Array:
    """Right of the path and above the camera's path of the signs that face the travel, (n, 2) metres."""
    height = truth["camera"]["mount"]["height_m"]
    rows = [
        (sign["lateral_m"], sign["up_m"] - height)
        for sign in truth["signs"]
        if sign["faces_travel"] and sign["eligible_frames"] > 0
    ]
    return np.array(rows, np.float64).reshape(-1, 2)


def box_labels(box: Boxes, views: Sequence[View]) -> tuple[NDArray[np.int8], Array]:
    """Label (n,) of each box (n, 4) of an image, and its overlap (n,) with the nearest panel.

    A box is `ON` a panel, `OFF` all, or `NEITHER`. Where a tight box is on a panel, a looser one is not an example. A
    box that shows only a part of it, or a second one as well, is not either: a classifier that accepts both loses the
    plaque below a sign. Panels that are no example make none of the boxes near them.
    """
    if not views:
        return np.full(len(box), labelled.OFF, np.int8), np.zeros(len(box))
    faces = np.array([view.box for view in views], np.float64)
    is_example = np.array([view.example for view in views])
    overlap, shared = iou_matrix(box, faces), intersection_areas(box, faces)
    best, rows = overlap.argmax(axis=1), np.arange(len(box))
    nearest = overlap[rows, best]
    tight = overlap.max(axis=0, initial=0)[best] >= TIGHT
    label = np.where(nearest >= labelled.NEAR_FACE, labelled.NEITHER, labelled.OFF).astype(np.int8)
    label[(nearest >= np.where(tight, TIGHT, labelled.ON_FACE)) & is_example[best]] = labelled.ON
    own = np.prod(box[:, 2:] - box[:, :2], axis=1)
    part = (shared[rows, best] > INSIDE * own) & (nearest < labelled.ON_FACE)
    label[part & tight & is_example[best]] = labelled.OFF
    second = (second_faces(box, faces, best) & is_example).any(axis=1)
    label[second & (nearest < UNION) & tight] = labelled.OFF
    label[second & (nearest >= UNION)] = labelled.NEITHER
    return label, nearest


def second_faces(box: Boxes, faces: Boxes, nearest: NDArray[np.integer]) -> Flags:
    """Which faces (m, 4) each box (n, 4) shows besides its `nearest` (n,), and that do not lie on that: (n, m)."""
    area = np.prod(faces[:, 2:] - faces[:, :2], axis=1)
    apart = intersection_areas(faces, faces) < APART * np.minimum(area[:, None], area[None])
    shown = intersection_areas(box, faces) > SHOWN * area
    return np.asarray(shown & apart[nearest])


@dataclass(frozen=True, slots=True)
class KnownPanels:
    """Panels of a drive with truth: by frame, and rotation (3, 3) to the world and centre (3,) of its camera.

    Real drives have no poses. Their signs may be groups of several panels, which are no sign and no other thing.
    """

    views: Mapping[int, Sequence[View]]
    poses: Mapping[int, tuple[Array, Array]] = field(default_factory=dict)

    @classmethod
    def of(cls, truth: Mapping[str, Any]) -> Self:
        """From the content of a `truth.json`."""
        views = {
            frame: [view for view in seen if view.back or view.sign["faces_travel"]]
            for frame, seen in views_by_frame(truth).items()
        }
        return cls(views, {frame["index"]: camera_pose(frame) for frame in truth["frames"]})

    @classmethod
    def of_labels(cls, labels: Mapping[str, Any], checked: Mapping[str, Any]) -> Self:
        """From the content of a `labels.json`, and from the checked boxes of the drive by number of the image."""
        views: dict[int, list[View]] = {}
        signs = [
            (sign | {"id": number}, sign.get("facing") == "back", view["i"], view["box"])
            for number, sign in enumerate(labels["signs"])
            for view in sign["boxes"]
        ]
        found = [(int(i), box[:4]) for i, seen in checked.items() for box in seen.get("signs", ())]
        signs += [({"id": -1 - n}, False, i, box) for n, (i, box) in enumerate(found)]
        for sign, back, frame, box in signs:
            views.setdefault(frame, []).append(View(sign, back, tuple(box)))
        return cls(views)

    def label(self, landmark: Landmark) -> int:
        """`ON` where the nearest views lie on one true panel, seen from its side, and it was measured there.

        Without the boxes it is `NEITHER`: perhaps a part of that panel. All else is `OFF`: half a face at a wrong
        depth, or rays that met by chance, are no signs either. On real drives all boxes there are decide; they leave
        out images of a sign, so that only those images count that have both.
        """
        if not self.poses:
            seen = self._overlaps(landmark.views, landmark.back)
            on = [np.median(o) >= TRACK_ON for sign, o in seen.values() if not sign.get("group")]
            near = any(max(own) > TRACK_NEAR for _, own in seen.values())
            return labelled.ON if any(on) else labelled.NEITHER if near else labelled.OFF
        rotation, origin = self.poses[landmark.best_frame]

        def stands_there(sign: Mapping[str, Any]) -> bool:
            actual = (np.array(sign["centre"], np.float64) - origin) @ rotation
            return bool(np.isfinite(match_distance(landmark.position - actual, actual)))

        return self.label_in_images(landmark, stands_there)

    def label_in_images(
        self, landmark: Landmark, counts: Callable[[Mapping[str, Any]], bool] = lambda sign: True
    ) -> int:
        """The same by the boxes of its nearest views alone, of the signs that count."""
        views = sorted(landmark.views, key=lambda view: -view.frame)[: labelled.NEAREST]
        on = [
            float(np.median([*own, *[0.0] * (len(views) - len(own))])) >= TRACK_ON
            for sign, own in self._overlaps(views, landmark.back).values()
            if max(own) > TRACK_NEAR and counts(sign)
        ]
        return labelled.ON if any(on) else labelled.NEITHER if on else labelled.OFF

    def _overlaps(
        self, views: Iterable[Observation], back: bool
    ) -> dict[int, tuple[Mapping[str, Any], list[float]]]:
        """Each sign that images show from that side, with the overlaps (IoU) of its boxes, an image each."""
        overlaps: dict[int, tuple[Mapping[str, Any], list[float]]] = {}
        for view in views:
            for one in self.views.get(view.frame, ()):
                if one.back == back:
                    overlap = iou_matrix(np.array([view.box]), np.array([one.box]))[0, 0]
                    _, own = overlaps.setdefault(one.sign["id"], (one.sign, []))
                    own.append(float(overlap))
        return overlaps
