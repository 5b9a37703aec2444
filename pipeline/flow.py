"""The way of a frame from the log to a sign: which stage follows which.

Read it beside the report: K-means, difference image, K-means again, size gate (chapters 2 and 3.1); colour
(3.2); shape (4); SIFT (5); motion by straight line and adjustment (7 and 8); matching and triangulation (5, 7);
trajectory (5); location (8, 11). The report replaced shape by trajectory, and that by location: its presets have one
of the three. After the last frame: the path of the whole drive in its world frame, and the signs on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Protocol

from wayside.pipeline.image_memory import ImageMemory
from wayside.pipeline.journal import Journal
from wayside.pipeline.model_files import Models
from wayside.pipeline.route_file import RouteFile
from wayside.pipeline.workers import Item, Result, StageClock, Value, ordered_parallel
from wayside.schemas.detections import Detections, Segmentation
from wayside.schemas.detectors import BoxFile, DetectorFile
from wayside.schemas.frame import Frame, Image
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import Settings
from wayside.schemas.signs import Sign
from wayside.stages.calibration import (
    CalibrationWatch,
    LensCheck,
    check_calibration,
    watch_calibration,
)
from wayside.stages.detection import (
    BoxClassifier,
    BoxNetwork,
    DetectionNetwork,
    OnnxDetector,
    detect,
    detect_externally,
    propose,
)
from wayside.stages.georeference import (
    DrivePath,
    DriveRecord,
    collect,
    georeference,
    measure_along_route,
    place_signs,
)
from wayside.stages.imaging import decode
from wayside.stages.mapping import (
    LandmarkClassifier,
    SideClassifiers,
    assemble,
    classify_location,
    score_by_views,
    track,
)
from wayside.stages.odometry import estimate_motion, extract_features
from wayside.stages.panel import PanelMethod
from wayside.stages.report import (
    classify_color,
    classify_shape,
    classify_trajectory,
    extract_sift,
    match_by_descriptors,
)
from wayside.stages.segmentation import segment
from wayside.stages.sign_codes import FaceClassifier, assign_codes, classify_faces


class Observer(Protocol):
    """Sees every item that leaves a stage, in the thread that made it."""

    def see(self, stage: str, item: Item) -> None:
        """Take note; must not raise and must not keep the run waiting."""


@dataclass(slots=True)
class FrameCounts:
    """Frames that were looked at, each for itself, and those that the stages which need the order are done with."""

    looked_at: int = 0
    settled: int = 0


@dataclass(slots=True)
class Flow:
    """The chain with its settings and models; one instance serves one log."""

    settings: Settings
    models: Models
    clock: StageClock
    observer: Observer | None = None
    journal: Journal | None = None
    routes: RouteFile | None = None
    record: DriveRecord = field(default_factory=DriveRecord)
    calibration: CalibrationWatch = field(init=False)
    memory: ImageMemory = field(default_factory=ImageMemory)
    counts: FrameCounts = field(default_factory=FrameCounts)
    boxes: BoxNetwork | None = field(init=False)
    faces: FaceClassifier | None = field(init=False)
    proposer: DetectionNetwork | None = field(init=False)
    external: OnnxDetector | BoxFile | None = field(init=False)

    def __post_init__(self) -> None:
        """Watch the calibration by its settings, and load the networks that all workers share."""
        self.calibration, m = CalibrationWatch(), self.models
        self.boxes = None if m.box_network is None else BoxNetwork(m.box_network.path)
        self.faces = None if m.face_network is None else FaceClassifier(m.face_network.path)
        own = None if m.external else m.detection_network
        self.proposer = None if own is None else DetectionNetwork(own.path)
        given = m.external
        self.external = OnnxDetector(given) if isinstance(given, DetectorFile) else given

    def track(self, frames: Iterator[Frame]) -> Iterator[TrackedFrame]:
        """Send frames all the way: every frame comes out once, in order, with the landmarks first seen in it."""
        run = self.settings.run
        read, memory = self.stage("read", self.memory.taken(frames)), self.memory
        found = ordered_parallel(
            self.resume,
            read,
            workers=run.workers,
            queue=run.queue,
            has_room=lambda: memory.has_room,
        )
        if self.journal is not None:
            found = self.clock.timed("journal", self.journal.record(found))
        for settled in self.follow(self._counted(self.clock.timed("queue", found))):
            self.counts.settled += 1
            yield settled

    def _counted(self, found: Iterator[Detections]) -> Iterator[Detections]:
        for item in found:
            self.counts.looked_at += 1
            yield item

    def resume(self, frames: Iterator[Frame]) -> Iterator[Detections]:
        """Take from the journal what a run before has found in the first frames, and detect in the others."""
        for frame in frames:
            if self.journal is None or frame.index not in self.journal:
                yield from self.detect(chain([frame], frames))
                return
            for image in self.stage("decode", decode(iter([frame]), self.settings.balance)):
                known = self.journal.replay(image)
                yield from self.detect(iter([frame])) if known is None else (known,)

    def detect(self, frames: Iterator[Frame]) -> Iterator[Detections]:
        """Do what one image needs for itself; runs side by side in the workers."""
        stage, s = self.stage, self.settings
        images = stage("decode", decode(frames, s.balance))
        found = (
            self._by_segments(images) if self.models.external is None else self._external(images)
        )
        if s.features.sift:
            found = stage("sift", extract_sift(found))
        return stage("features", extract_features(found, settings=s.features))

    def _by_segments(self, images: Iterator[Image]) -> Iterator[Detections]:
        """Segmentation, and then what the preset makes of its regions."""
        s = self.settings
        segmented = self.stage("segment", segment(images, settings=s.segment, gate=s.gate))
        by_report = s.candidates.classifier == "report"
        return self._by_report(segmented) if by_report else self._by_classifier(segmented)

    def _external(self, images: Iterator[Image]) -> Iterator[Detections]:
        """The boxes of another detector: they are the detections, and wayside's own does not run."""
        s = self.settings
        if self.external is None or self.boxes is None:
            raise ValueError(
                "models: wanted a detector or a file of boxes, and the box network, found none"
            )
        return self.stage(
            "detect",
            detect_externally(
                images,
                source=self.external,
                settings=s.candidates,
                network=self.boxes,
            ),
        )

    def _by_report(self, segmented: Iterator[Segmentation]) -> Iterator[Detections]:
        """The report's gates of one image: colour (chapter 3.2), and in its first chain shape (chapter 4)."""
        m = self.models
        if m.color_classes is None:
            raise ValueError("models: wanted the report's colour classes, found none")
        colored = self.stage("color", classify_color(segmented, model=m.color_classes))
        if m.shape_classes is None:
            return colored
        return self.stage("shape", classify_shape(colored, model=m.shape_classes))

    def _by_classifier(self, segmented: Iterator[Segmentation]) -> Iterator[Detections]:
        """Boxes of the detection network beside the segments, and a learned classifier on each."""
        stage, s, m = self.stage, self.settings, self.models
        if self.boxes is None or m.front_scores is None:
            raise ValueError("models: wanted the box network and its thresholds, found none")
        proposed = stage(
            "propose", propose(segmented, settings=s.candidates, network=self.proposer)
        )
        return stage(
            "detect",
            detect(
                proposed,
                settings=s.candidates,
                network=self.boxes,
                front=m.front_scores,
                back=m.back_scores,
            ),
        )

    def follow(self, detections: Iterator[Detections]) -> Iterator[TrackedFrame]:
        """Do what needs the frames in order: motion, tracks, landmarks."""
        stage, s, m = self.stage, self.settings, self.models
        posed = stage(
            "motion",
            estimate_motion(detections, settings=s.motion),
        )
        posed = self.memory.released(posed, lambda one: one.motion is None)
        watched = self.clock.timed("calibration", watch_calibration(posed, self.calibration))
        tracked = self.memory.released(stage("track", self._tracked(watched)), lambda one: True)
        if m.trajectory_density is not None:
            moves = classify_trajectory(tracked, model=m.trajectory_density)
            tracked = stage("trajectory", moves)
        if s.locate.gate:
            by_report = s.candidates.classifier == "report"
            refusing = m.location_classes if by_report else None  # else a term of the evidence
            places = classify_location(tracked, model=refusing, settings=s.locate)
            tracked = stage("location", places)
        if self.faces is not None:
            tracked = stage("face", classify_faces(tracked, model=self.faces))
        assembled = stage("assemble", assemble(tracked, settings=s.assembly))
        return self.clock.timed("collect", collect(assembled, record=self.record))

    def georeference(self) -> DrivePath:
        """After the last frame: the path of the whole drive in its world frame and on the globe."""
        s, points = self.settings, iter(self.record.points)
        laid = georeference(points, motion=s.motion, landmark=s.landmark)
        (path,) = self.drive_stage("georeference", laid)
        return path

    def check_calibration(self) -> LensCheck:
        """After the last frame: what the drive says of the lens."""
        checked = check_calibration(iter((self.calibration,)))
        (found,) = self.drive_stage("lens", checked)
        return found

    def signs(self, path: DrivePath) -> Iterator[Sign]:
        """After the last frame: the signs of the drive on its path, in the order of their numbers."""
        s, landmarks = self.settings, iter(self.record.landmarks)
        # scores of another detector are no probabilities: what its least score let through is a sign
        external = self.models.external is not None
        confidence = 0.0 if external else self.models.sign_confidence(s.locate.confidence)
        placed = place_signs(landmarks, path=path, confidence=confidence)
        placed = self.drive_stage("signs", placed)
        route = s.route
        if route.milepost >= 0:
            placed = self.drive_stage(
                "route", measure_along_route(placed, path=path, settings=route)
            )
        elif self.routes is not None and path.globe is not None:
            near = self.routes.near(path.globe.route()[:, :2])
            measured = measure_along_route(placed, path=path, settings=route, segments=near)
            placed = self.drive_stage("route", measured)
        classes = () if self.faces is None else self.faces.classes
        coded = assign_codes(placed, settings=s.codes, classes=classes)
        return self.drive_stage("codes", coded)

    def _tracked(self, posed: Iterator[PosedDetections]) -> Iterator[TrackedFrame]:
        """By descriptors as in the report, or by predicted position."""
        s = self.settings
        if s.track.matching == "sift":
            return match_by_descriptors(posed, settings=s.mapping)
        front, back = self._side_classifiers()
        tracked = track(
            posed,
            settings=s.mapping,
            front=front,
            back=back,
            panel=self.panel_method(),
            jointly=True,
        )
        return tracked if self.models.external is None else score_by_views(tracked)

    def _side_classifiers(self) -> tuple[SideClassifiers, SideClassifiers | None]:
        """Classifiers of faces and of backs, learned on the scores of wayside's own detector; none for another's."""
        m, s = self.models, self.settings
        if m.external is not None:
            return SideClassifiers(), None
        front, back = (
            LandmarkClassifier(model, s.landmark)
            for model in (m.landmark_classifier, m.back_landmark_classifier)
        )
        faces, behind = self.box_classifiers()
        if behind is None:
            return SideClassifiers(faces, front), None
        return SideClassifiers(faces, front), SideClassifiers(behind, back)

    def box_classifiers(self) -> tuple[BoxClassifier | None, BoxClassifier | None]:
        """Classifiers of boxes as faces and as backs, where there are such."""
        m, network = self.models, self.boxes
        if network is None:
            return None, None
        front, back = (
            None
            if scores is None
            else BoxClassifier(network, scores, self.settings.candidates, back=side)
            for scores, side in ((m.front_scores, False), (m.back_scores, True))
        )
        return front, back

    def panel_method(self) -> PanelMethod:
        """How panels are measured as planes."""
        return PanelMethod(self.models.outline_weights)

    def stage(self, name: str, items: Iterator[Result]) -> Iterator[Result]:
        """The items of a stage: timed, its faults named, and every item shown to the observer."""
        for item in self.clock.timed(name, items):
            if self.observer is not None:
                with self.clock.aside("view"):
                    self.observer.see(name, item)
            yield item

    def drive_stage(self, name: str, items: Iterator[Value]) -> Iterator[Value]:
        """The items of a stage after the last frame: timed, its faults named."""
        return self.clock.timed_drive(name, items)
