"""The inputs of the classifiers on labelled drives, with the answer of the labels: one table for all.

The flow runs as in `wayside run`, and an observer records the input of each classifier. The size gate gets the
connected regions, the colour gate those that pass it, and the shape gate those that pass that. The location gets the
triangulated landmarks. In preset `default`, boxes and landmarks are scored.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.labels.read import LogImages, labels_by_frame
from wayside.pipeline.learning.labelled import NEITHER, ON, Faces, labelled_faces
from wayside.pipeline.models.model_files import TRAJECTORY_FILES, Models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.flow import Flow, Observer
from wayside.pipeline.workers import Item, StageClock
from wayside.schemas.detections import COLORS, SHAPES, Detections, Rows, Segmentation, verdict_code
from wayside.schemas.errors import InputError
from wayside.schemas.labels import Labels
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.models import MixtureModel
from wayside.schemas.settings import GateSettings, ReadSettings, Settings
from wayside.schemas.signs import Sign
from wayside.stages.mapping import VERDICT_OF_TERM
from wayside.stages.report import color_features, fourier_descriptors, outlines_of, track_log_ratio
from wayside.stages.segmentation import regions_before_gate

NO_CLASS = ""
"""Class of what is no sign, and of what a classifier refuses."""

TRAJECTORIES = {form: file.removesuffix(".json") for form, file in TRAJECTORY_FILES.items()}

_BEFORE, _AFTER = ("size", "color", "shape"), ("detector", "landmark", "location", "confidence")
CLASSIFIERS = (*_BEFORE, *TRAJECTORIES.values(), *_AFTER)
"""Every classifier of the presets, in the order of the chain."""

_LABELS = 3
_KINDS: dict[str, tuple[Any, ...]] = {
    "label": (np.int8,),
    "kind": (np.str_,),
    "accepted": (np.bool_,),
    "named": (np.str_,),
    "drive": (np.str_,),
    "frame": (np.int32,),
    "box": (np.float32, 4),
    "count": (np.int64,),
}
_REST: dict[str, Any] = {"kind": NO_CLASS, "named": NO_CLASS, "box": np.nan, "count": 1}


@dataclass(frozen=True, slots=True)
class ClassifierSamples(Rows):
    """What one classifier was asked about, n rows, in order of drive and frame.

    `classifier`: its name. `space`: of its values. `values` (n, d) float64. `label` (n,) int8 `OFF`, `ON` or `NEITHER`
    a sign. `kind` (n,): class of the labelled sign in this classifier's terms, or `NO_CLASS`. `accepted` (n,) bool:
    what it decided. `named` (n,): the class that it gave, `NO_CLASS` where it refused. `drive` (n,), `frame` (n,)
    int32, box (n, 4) float32: where it came from (of a landmark its best view), pixels. `count` (n,) int64: how many
    equal ones of the same frame the row stands for (of the size gate; else 1), their boxes nan.
    """

    classifier: str
    space: str
    values: NDArray[np.float64]
    label: NDArray[np.int8]
    kind: NDArray[np.str_]
    accepted: NDArray[np.bool_]
    named: NDArray[np.str_]
    drive: NDArray[np.str_]
    frame: NDArray[np.int32]
    box: NDArray[np.float32]
    count: NDArray[np.int64]

    def known(self) -> Self:
        """Those that are on a sign or off all signs."""
        return self.select(self.label != NEITHER)

    def confusion(self) -> dict[tuple[str, str], int]:
        """How many samples of each labelled class got which class, as the run decided."""
        own = self.known()
        labelled = np.where(own.label == ON, np.where(own.kind == "", "sign", own.kind), "none")
        given = np.where(own.accepted, np.where(own.named == "", "accepted", own.named), "refused")
        counts: Counter[tuple[str, str]] = Counter()
        for *pair, count in zip(labelled.tolist(), given.tolist(), own.count.tolist(), strict=True):
            counts[pair[0], pair[1]] += count
        return dict(sorted(counts.items()))


def join_drives(drives: Iterable[Mapping[str, ClassifierSamples]]) -> dict[str, ClassifierSamples]:
    """The samples of several drives together, by classifier."""
    parts: dict[str, list[ClassifierSamples]] = {}
    for drive in drives:
        for name, samples in drive.items():
            parts.setdefault(name, []).append(samples)
    return {name: ClassifierSamples.joined(own) for name, own in parts.items()}


def faces_of_log(log: Path, labels: Labels, settings: ReadSettings) -> Faces:
    """The labelled faces in the images of a log; raises InputError where none of the labels is of it."""
    known = LogImages.of(log, settings)
    found = labels_by_frame(labels, log.stem, known.times_ns, known.names)
    if not found.labels and not found.complete:
        reasons = ", ".join(f"{count} {reason}" for reason, count in found.left_out.items())
        raise InputError(
            f"{log}: no label belongs to its images ({reasons}). See docs/labels.md for how an image is named."
        )
    return labelled_faces(found)


def gather_samples(
    log: Path,
    faces: Faces,
    settings: Settings,
    models: Models,
    also: Observer | None = None,
    undecided: Sequence[MixtureModel] = (),
    only: Collection[str] | None = None,
) -> dict[str, ClassifierSamples]:
    """What every classifier is asked about when a log is run, by the classifier's name, in the order of the chain.

    `faces`: those of its images. `also`: sees every item of the run, too. `undecided`: densities of trajectories, one a
    form, that are asked about every track but decide nothing in this run; their samples bear the names of their files.
    `only`: classifiers that are asked, None: all; the size gate takes half the time. Raises InputError where the log
    cannot be used, StageError where a stage fails.
    """
    densities = {TRAJECTORIES[density.space]: density for density in undecided}
    if models.trajectory_density is not None:
        densities["trajectory"] = models.trajectory_density
    wanted = CLASSIFIERS if only is None else only
    collector = _Collector(log.stem, faces, models, settings.gate, also, densities, wanted)
    flow = Flow(settings, models, StageClock(), collector)
    for _ in flow.track(read_frames(log, settings.read, ReadReport())):
        pass
    for sign in flow.finish().signs:
        collector.see_sign(sign)
    return collector.samples()


@dataclass
class _Collector:
    """Sees the items of a flow and keeps what its classifiers were asked; frames may come in any order."""

    drive: str
    faces: Faces
    models: Models
    gate: GateSettings
    also: Observer | None
    densities: Mapping[str, MixtureModel]
    only: Collection[str]

    def __post_init__(self) -> None:
        self._asked: dict[str, list[ClassifierSamples]] = {}
        self._by_stage: dict[str, Callable[[Any], Iterable[ClassifierSamples]]] = {
            "color": self._color,
            "shape": self._shape,
            "detect": self._boxes,
            "track": self._tracked,
            "location": self._located,
        }
        if "size" in self.only:
            self._by_stage["segment"] = self._size

    def see(self, stage: str, item: Item) -> None:
        """Keep the inputs of the classifier of this stage, if it has one."""
        if self.also is not None:
            self.also.see(stage, item)
        for asked in self._by_stage[stage](item) if stage in self._by_stage else ():
            self._asked.setdefault(asked.classifier, []).append(asked)

    def see_sign(self, sign: Sign) -> None:
        """Keep the inputs of the threshold of the confidence, which preset `report` does not have."""
        if sign.status in ("sign", "uncertain") and self.models.color_classes is None:
            value, is_sign = [(sign.confidence,)], [sign.status == "sign"]
            asked = self._landmarks("confidence", [sign.landmark], "probability", value, is_sign)
            self._asked.setdefault("confidence", []).append(asked)

    def samples(self) -> dict[str, ClassifierSamples]:
        """All inputs, by classifier, in the order of the chain and of the frames."""
        names = (one for one in self.only if one in self._asked)
        joined = {name: ClassifierSamples.joined(self._asked[name]) for name in names}
        return {k: own.select(np.argsort(own.frame, kind="stable")) for k, own in joined.items()}

    def _ask(self, classifier: str, space: str, values: Any, **columns: Any) -> ClassifierSamples:
        """A table; a single value in a column counts for all rows."""
        values = np.asarray(values, np.float64)
        given = _REST | {"drive": self.drive} | columns
        rest = {
            name: np.broadcast_to(np.asarray(given[name], kind), (len(values), *width))
            for name, (kind, *width) in _KINDS.items()
        }
        return ClassifierSamples(classifier, space, values, **rest)

    def _size(self, item: Segmentation) -> Iterator[ClassifierSamples]:
        """Areas of all connected regions, equal ones of a frame counted in one row."""
        if item.image.rgb is None:
            return
        regions, frame = regions_before_gate(item), item.frame.index
        label, _ = self.faces.label_regions(frame, regions.box)
        # area and label in one number: far faster to sort than pairs
        pairs, count = np.unique(
            regions.area_px.astype(np.int64) * _LABELS + (label - NEITHER), return_counts=True
        )
        area, label = pairs // _LABELS, pairs % _LABELS + NEITHER
        accepted = (area >= self.gate.smallest_px) & (area <= self.gate.largest_px)
        columns = {"frame": frame, "label": label, "accepted": accepted, "count": count}
        yield self._ask("size", "area_px", area[:, None], **columns)

    def _color(self, item: Detections) -> Iterator[ClassifierSamples]:
        every, colors = item.candidates, self.models.color_classes
        space = "rgb" if colors is None else colors.space
        values = color_features(every.regions.rgb, space)
        accepted = every.verdict != verdict_code("color")
        names = (self.faces.color, COLORS, every.color)
        yield self._regions("color", item, np.arange(len(every)), space, values, accepted, names)

    def _shape(self, item: Detections) -> Iterator[ClassifierSamples]:
        every = item.candidates
        refused = every.verdict == verdict_code("shape")
        rows = np.flatnonzero(refused | (every.verdict == verdict_code("open")))
        values = fourier_descriptors(outlines_of(item.segmentation, every.regions.select(rows)))
        names = (self.faces.shape, SHAPES, every.shape[rows])
        yield self._regions("shape", item, rows, "fourier8", values, ~refused[rows], names)

    def _boxes(self, item: Detections) -> Iterator[ClassifierSamples]:
        """Every box that the detector scored. A box that a better box suppresses does not count as refused."""
        score, learned = item.candidates.score, self.models.front_scores
        rows = np.flatnonzero(np.isfinite(score))
        above = score[rows] >= (-np.inf if learned is None else learned.threshold)
        yield self._regions("detector", item, rows, "log_odds", score[rows, None], above)

    def _regions(
        self,
        classifier: str,
        item: Detections,
        rows: NDArray[np.int64],
        space: str,
        values: NDArray[np.floating[Any]],
        accepted: NDArray[np.bool_],
        names: tuple[NDArray[np.str_], tuple[str, ...], NDArray[np.integer[Any]]] | None = None,
    ) -> ClassifierSamples:
        """Candidates of one image; names: of the faces, of the classes, and the class (rows,) that each was given."""
        frame, box = item.frame.index, item.candidates.regions.box[rows]
        label, face = self.faces.label_regions(frame, box)
        columns = {"frame": frame, "label": label, "accepted": accepted, "box": box}
        if names is not None:
            of_face, classes, code = names
            columns["kind"] = np.append(of_face, NO_CLASS)[face]
            columns["named"] = np.array([*classes, NO_CLASS])[np.where(accepted, code, -1)]
        return self._ask(classifier, space, values, **columns)

    def _tracked(self, frame: TrackedFrame) -> Iterator[ClassifierSamples]:
        """Landmarks before the gates of landmarks: faces that the landmark classifier scores, and trajectories."""
        if self.models.color_classes is not None:
            yield from self._moved(frame)
            return
        verdicts = ("sign", *VERDICT_OF_TERM.values())
        asked = [
            one
            for one in frame.landmarks
            if not one.back and one.features and one.verdict in verdicts
        ]
        if asked:
            accepted = [one.verdict == "sign" for one in asked]
            # the sum of the evidence, and each term
            values = [(one.score, *(ratio for _, ratio in one.evidence)) for one in asked]
            yield self._landmarks("landmark", asked, "log_odds", values, accepted)

    def _moved(self, frame: TrackedFrame) -> Iterator[ClassifierSamples]:
        """Landmarks that no stage before the trajectory gate refused, whether a run has that gate or not."""
        asked = [one for one in frame.landmarks if one.verdict == "sign"]
        for name, density in self.densities.items() if asked else ():
            values = [(track_log_ratio(one, density),) for one in asked]
            accepted = [value >= density.threshold for (value,) in values]
            yield self._landmarks(name, asked, "log_ratio", values, accepted)

    def _located(self, frame: TrackedFrame) -> Iterator[ClassifierSamples]:
        """Landmarks that were signs but for their location; in preset `default` that is a term of the evidence."""
        asked = [one for one in frame.landmarks if one.verdict in ("sign", "location")]
        if asked and self.models.color_classes is not None:
            places = [(one.right_m, one.above_m) for one in asked]
            sizes = np.log([(one.width_m, one.height_m) for one in asked])
            accepted = [one.verdict != "location" for one in asked]
            yield self._landmarks("location", asked, "right_up_m", places, accepted)
            yield self._landmarks("panel_size", asked, "log_m", sizes, accepted)

    def _landmarks(
        self,
        classifier: str,
        landmarks: Sequence[Landmark],
        space: str,
        values: Any,
        accepted: Sequence[bool],
    ) -> ClassifierSamples:
        views = [[(view.frame, view.box) for view in one.views] for one in landmarks]
        return self._ask(
            classifier,
            space,
            values,
            frame=[one.best_frame for one in landmarks],
            label=[self.faces.label_views(own) for own in views],
            accepted=accepted,
            box=[one.best_box for one in landmarks],
        )
