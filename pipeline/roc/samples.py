"""What each classifier of the chain is really asked about on a drive, with the answer that labels give.

The flow runs as in `wayside run`; an observer takes the input of each classifier where it stands: the connected regions
for the size gate, those that pass it for the colour gate, those that pass that for the shape gate, the triangulated
landmarks for the location, and in preset `default` the boxes and landmarks that are scored.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.flow import Flow, Observer
from wayside.pipeline.labels import LogImages, labels_by_frame
from wayside.pipeline.learning.samples import NEITHER
from wayside.pipeline.model_files import TRAJECTORY_FILES, Models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.roc.classifier_samples import NO_CLASS, ClassifierSamples
from wayside.pipeline.roc.faces import Faces, labelled_faces
from wayside.pipeline.workers import Item, StageClock
from wayside.schemas.detections import COLORS, SHAPES, Detections, Segmentation, verdict_code
from wayside.schemas.errors import InputError
from wayside.schemas.labels import Labels
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.models import MixtureModel
from wayside.schemas.settings import GateSettings, Settings
from wayside.schemas.signs import Sign
from wayside.stages.mapping import VERDICT_OF_TERM
from wayside.stages.report import color_features, mean_log_density, region_descriptors
from wayside.stages.segmentation import regions_before_gate

_LABELS = 3
TRAJECTORIES = {form: file.removesuffix(".json") for form, file in TRAJECTORY_FILES.items()}


def gather_samples(
    log: Path,
    labels: Labels,
    settings: Settings,
    models: Models,
    also: Observer | None = None,
    undecided: Sequence[MixtureModel] = (),
    only: Collection[str] | None = None,
) -> dict[str, ClassifierSamples]:
    """What every classifier is asked about when a log is run, by the classifier's name, in the order of the chain.

    Parameters
    ----------
    log
        The MCAP file.
    labels
        Of its images, and perhaps of those of other logs.
    settings, models
        What the run works with.
    also
        Sees every item of the run, too.
    undecided
        Densities of trajectories, one a form, that are asked about every track but decide nothing in this run; their
        samples bear the names of their files.
    only
        Classifiers that are asked; None: all. The size gate takes half of the time.

    Raises
    ------
    InputError
        The log cannot be used, or none of the labels is of it.
    StageError
        A stage failed.
    """
    known = LogImages.of(log, settings.read)
    found = labels_by_frame(labels, log.stem, known.times_ns, known.names)
    if not found.labels and not found.complete:
        reasons = ", ".join(f"{count} {reason}" for reason, count in found.left_out.items())
        raise InputError(
            f"{log}: wanted labels of its images, found none ({reasons}); see docs/labels.md for how an image is named"
        )
    only = CLASSIFIERS if only is None else only
    faces = labelled_faces(found)
    collector = _Collector(faces, models, settings.gate, log.stem, also, undecided, only)
    flow = Flow(settings, models, StageClock(), collector)
    for _ in flow.track(read_frames(log, settings.read, ReadReport())):
        pass
    for sign in flow.finish().signs:
        collector.see_sign(sign)
    return collector.samples()


@dataclass(frozen=True, slots=True)
class _Asked:
    """Questions put at once: as in `ClassifierSamples`, without the drive."""

    space: str
    frame: NDArray[np.int64]
    values: NDArray[np.floating[Any]]
    label: NDArray[np.int8]
    kind: Sequence[str] | NDArray[np.str_]
    accepted: NDArray[np.bool_]
    named: Sequence[str] | NDArray[np.str_]
    box: NDArray[np.floating[Any]]
    count: NDArray[np.int64] | None = None


class _Collector:
    """Sees the items of a flow and keeps what its classifiers were asked; frames may come in any order."""

    def __init__(
        self,
        faces: Faces,
        models: Models,
        gate: GateSettings,
        drive: str,
        also: Observer | None,
        undecided: Sequence[MixtureModel],
        only: Collection[str],
    ) -> None:
        self._faces, self._models, self._gate, self._drive = faces, models, gate, drive
        self._also = also
        self._densities = {TRAJECTORIES[density.space]: density for density in undecided}
        if models.trajectory_density is not None:
            self._densities["trajectory"] = models.trajectory_density
        self._asked: list[tuple[str, _Asked]] = []
        self._only = only
        self._by_stage: dict[str, Callable[[Any], Iterable[tuple[str, _Asked]]]] = {
            "segment": self._size,
            "color": self._color,
            "shape": self._shape,
            "detect": self._boxes,
            "track": self._tracked,
            "location": self._located,
        }

    def see(self, stage: str, item: Item) -> None:
        """Keep what the classifier of this stage was asked; other stages have none."""
        if self._also is not None:
            self._also.see(stage, item)
        if stage in self._by_stage and (stage != "segment" or "size" in self._only):
            self._asked.extend(self._by_stage[stage](item))

    def see_sign(self, sign: Sign) -> None:
        """Keep what the threshold of the confidence was asked; preset `report` gives none."""
        if sign.status in ("sign", "uncertain") and self._models.color_classes is None:
            accepted, value = [sign.status == "sign"], [(sign.confidence,)]
            asked = self._landmarks([sign.landmark], "probability", value, accepted)
            self._asked.append(("confidence", asked))

    def samples(self) -> dict[str, ClassifierSamples]:
        """All that was asked, by classifier, in the order of the chain and of the frames."""
        return {
            name: self._together(name, own)
            for name in CLASSIFIERS
            if name in self._only
            and (own := [asked for other, asked in self._asked if other == name])
        }

    def _together(self, name: str, asked: list[_Asked]) -> ClassifierSamples:
        def column(values: Callable[[_Asked], Any], kind: Any) -> NDArray[Any]:
            return np.concatenate([np.asarray(values(one), kind) for one in asked])

        frame = column(lambda one: one.frame, np.int32)
        samples = ClassifierSamples(
            name,
            asked[0].space,
            column(lambda one: one.values, np.float64),
            column(lambda one: one.label, np.int8),
            column(lambda one: one.kind, np.str_),
            column(lambda one: one.accepted, np.bool_),
            column(lambda one: one.named, np.str_),
            np.full(len(frame), self._drive),
            frame,
            column(lambda one: one.box, np.float32),
            column(
                lambda one: np.ones(len(one.label)) if one.count is None else one.count, np.int64
            ),
        )
        return samples.select(np.argsort(frame, kind="stable"))

    def _size(self, item: Segmentation) -> Iterable[tuple[str, _Asked]]:
        """Areas of all connected regions, equal ones of a frame counted in one row."""
        if item.image.rgb is None:
            return
        regions = regions_before_gate(item)
        label, _ = self._faces.label_regions(item.frame.index, regions.box)
        # area and label in one number: far faster to sort than pairs
        pairs, count = np.unique(
            regions.area_px.astype(np.int64) * _LABELS + (label - NEITHER), return_counts=True
        )
        area, kind = pairs // _LABELS, pairs % _LABELS + NEITHER
        none = [NO_CLASS] * len(area)
        asked = _Asked(
            "area_px",
            np.full(len(area), item.frame.index),
            area[:, None],
            kind.astype(np.int8),
            none,
            (area >= self._gate.smallest_px) & (area <= self._gate.largest_px),
            none,
            np.full((len(area), 4), np.nan),
            count,
        )
        yield "size", asked

    def _color(self, item: Detections) -> Iterable[tuple[str, _Asked]]:
        rows = np.arange(len(item.candidates))
        refused = item.candidates.verdict == verdict_code("color")
        colors = self._models.color_classes
        space = "rgb" if colors is None else colors.space
        yield (
            "color",
            self._regions(
                item,
                rows,
                space,
                color_features(item.candidates.regions.rgb, space),
                ~refused,
                COLORS,
                item.candidates.color,
            ),
        )

    def _shape(self, item: Detections) -> Iterable[tuple[str, _Asked]]:
        candidates = item.candidates
        refused = candidates.verdict == verdict_code("shape")
        rows = np.flatnonzero(refused | (candidates.verdict == verdict_code("open")))
        values = region_descriptors(item.segmentation, candidates.regions.select(rows))
        yield (
            "shape",
            self._regions(
                item, rows, "fourier6", values, ~refused[rows], SHAPES, candidates.shape[rows]
            ),
        )

    def _boxes(self, item: Detections) -> Iterable[tuple[str, _Asked]]:
        """Every box that the detector scored; one that a better box suppresses is none that it refused."""
        candidates = item.candidates
        rows = np.flatnonzero(np.isfinite(candidates.score))
        learned = self._models.front_scores
        above = candidates.score[rows] >= (-np.inf if learned is None else learned.threshold)
        scores = candidates.score[rows, None]
        names = np.full(len(rows), -1)
        yield "detector", self._regions(item, rows, "log_odds", scores, above, (), names)

    def _regions(
        self,
        item: Detections,
        rows: NDArray[np.int64],
        space: str,
        values: NDArray[np.floating[Any]],
        accepted: NDArray[np.bool_],
        names: tuple[str, ...],
        code: NDArray[np.integer[Any]],
    ) -> _Asked:
        """Candidates of one image; `code` names them among `names`."""
        frame, box = item.frame.index, item.candidates.regions.box[rows]
        label, face = self._faces.label_regions(frame, box)
        of = {COLORS: self._faces.color, SHAPES: self._faces.shape}.get(names)
        kind = [NO_CLASS if of is None or i < 0 else of[i] for i in face]
        named = [
            names[c] if c >= 0 and ok else NO_CLASS for c, ok in zip(code, accepted, strict=True)
        ]
        return _Asked(space, np.full(len(box), frame), values, label, kind, accepted, named, box)

    def _tracked(self, frame: TrackedFrame) -> Iterable[tuple[str, _Asked]]:
        """Landmarks before the gates of landmarks: of faces what the landmark classifier scores, and trajectories."""
        if self._models.color_classes is not None:
            return self._moved(frame)
        asked = [
            one
            for one in frame.landmarks
            if not one.back and one.features and one.verdict in ("sign", *VERDICT_OF_TERM.values())
        ]
        if not asked:
            return ()
        accepted = [one.verdict == "sign" for one in asked]
        # the sum of the evidence, and each term
        values = [(one.score, *(ratio for _, ratio in one.evidence)) for one in asked]
        return (("landmark", self._landmarks(asked, "log_odds", values, accepted)),)

    def _moved(self, frame: TrackedFrame) -> Iterator[tuple[str, _Asked]]:
        """Landmarks that no stage before the trajectory gate refused, whether a run has that gate or not."""
        asked = [one for one in frame.landmarks if one.verdict == "sign"]
        for name, density in self._densities.items() if asked else ():
            values = [(mean_log_density(one.trajectory, density),) for one in asked]
            accepted = [value >= density.threshold for (value,) in values]
            yield name, self._landmarks(asked, "log_density", values, accepted)

    def _located(self, frame: TrackedFrame) -> Iterable[tuple[str, _Asked]]:
        """Landmarks that were signs but for their location; in preset `default` that is a term of the evidence."""
        asked = [one for one in frame.landmarks if one.verdict in ("sign", "location")]
        if asked and self._models.color_classes is not None:
            places = [(one.right_m, one.above_m) for one in asked]
            accepted = [one.verdict != "location" for one in asked]
            yield "location", self._landmarks(asked, "right_up_m", places, accepted)

    def _landmarks(
        self,
        landmarks: Sequence[Landmark],
        space: str,
        values: Sequence[tuple[float, ...]],
        accepted: Sequence[bool],
    ) -> _Asked:
        label = [
            self._faces.label_views([(view.frame, view.box) for view in one.views])
            for one in landmarks
        ]
        none = [NO_CLASS] * len(landmarks)
        return _Asked(
            space,
            np.array([one.best_frame for one in landmarks]),
            np.array(values),
            np.array(label, np.int8),
            none,
            np.array(accepted),
            none,
            np.array([one.best_box for one in landmarks]),
        )


CLASSIFIERS = (
    "size",
    "color",
    "shape",
    *TRAJECTORIES.values(),
    "detector",
    "landmark",
    "location",
    "confidence",
)
"""Every classifier of the presets, in the order of the chain."""

__all__ = [
    "CLASSIFIERS",
    "TRAJECTORIES",
    "gather_samples",
]
