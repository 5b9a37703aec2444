"""The presets as lists of stages, from an image to a sign.

The order of the report: K-means, difference image, K-means again and size gate (chapters 2 and 3.1), colour (3.2),
shape (4). Then SIFT (5), motion by straight line and adjustment (7 and 8), matching and triangulation (5, 7),
trajectory (5), location (8, 11). The report replaced shape by trajectory, and trajectory by location: each of its three
presets has one of these gates. Preset `default` keeps the order, with networks in the place of colours and shapes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from wayside.pipeline.detectors import Detector, detector_of
from wayside.pipeline.files.route_file import RouteFile
from wayside.pipeline.image_memory import ImageBuffers
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.workers import Stage, stage
from wayside.schemas.roadside import CrossSection
from wayside.schemas.settings import Settings
from wayside.stages.calibration import CalibrationWatch, check_calibration, watch_calibration
from wayside.stages.georeference import (
    DrivePath,
    DriveRecord,
    collect,
    georeference,
    measure_along_route,
    place_signs,
)
from wayside.stages.imaging import decode
from wayside.stages.mapping import PanelModels, assemble, classify_location, track
from wayside.stages.odometry import estimate_motion, extract_features
from wayside.stages.report import (
    classify_trajectory,
    extract_sift,
    match_segments,
    merge_segments,
    triangulate_points,
)
from wayside.stages.roadside import Sweep, measure_spacing, place_sections, sweep_roadside
from wayside.stages.sign_codes import FaceClassifier, assign_codes, classify_faces

Stages = list[Stage[Any, Any]]


@dataclass(frozen=True, slots=True)
class Chain:
    """The stages of a preset, for one drive."""

    per_image: Stages
    """From frames to detections: what one image needs for itself, side by side in the workers."""
    per_frame: Stages
    """From detections to tracked frames, in the order of the frames."""
    path: Stage[Any, DrivePath]
    """After the last frame: from the points of the path to the path of the whole drive."""
    signs: Callable[[DrivePath], Stages]
    """After it: from landmarks to the signs on that path."""
    lens: Stage[Any, Any]
    """After the last frame: the lens by the drive."""
    record: DriveRecord
    """Filled by `per_frame`, read by `path` and `signs`."""
    roadside: list[Sweep] | None
    """Filled by `per_frame`, read by `profile_stage`. None: the roadside is not measured."""
    calibration: CalibrationWatch
    """Filled by `per_frame`, read by `lens`."""


def chain_of(settings: Settings, models: Models, routes: RouteFile | None = None) -> Chain:
    """The chain of the preset that the settings are of."""
    s, m, report = settings, models, settings.report.on
    detector, record, watch = detector_of(s, m), DriveRecord(), CalibrationWatch()
    roadside: list[Sweep] | None = [] if s.roadside.on else None
    faces = FaceClassifier(m.face_network.path) if m.face_network and not report else None
    return Chain(
        per_image=_those(
            stage("decode", decode, s.balance, ImageBuffers().empty),
            *detector.stages,
            stage("sift", extract_sift) if report else None,
            stage("features", extract_features, s.features),
        ),
        per_frame=_those(
            stage("motion", estimate_motion, s.motion),
            stage("calibration", watch_calibration, watch).unseen(),
            None if roadside is None else stage("roadside", sweep_roadside, roadside).unseen(),
            *(_report_landmarks(s, m) if report else _landmarks(s, m, detector, faces)),
            stage("assemble", assemble),
            stage("collect", collect, record).unseen(),
        ),
        path=stage("georeference", georeference, s.motion),
        signs=lambda path: _signs(s, m, routes, path, faces.classes if faces else ()),
        lens=stage("lens", check_calibration),
        record=record,
        roadside=roadside,
        calibration=watch,
    )


def _landmarks(s: Settings, m: Models, detector: Detector, faces: FaceClassifier | None) -> Stages:
    """Preset `default`: boxes of networks or of another detector, tracks by predicted position, all evidence."""
    sides, panels = (detector.front, detector.back), PanelModels(m.outline_weights, m.post_kinds)
    return _those(
        stage("track", track, s.track, *sides, panels, jointly=True),
        stage("location", classify_location, None, s.locate),
        stage("face", classify_faces, model=faces) if faces else None,
    )


def _report_landmarks(s: Settings, m: Models) -> Stages:
    """Presets `report`, `report-2d` and `report-shape`: one of the gates shape, trajectory and location each."""
    moves, places, sizes = m.trajectory_density, m.location_classes, m.panel_sizes
    return _those(
        stage("track", match_segments, s.track),
        stage("trajectory", classify_trajectory, moves) if moves else None,
        stage("location", classify_location, places, s.locate) if s.locate.gate else None,
        stage("points", triangulate_points, sizes) if sizes else None,
        stage("panels", merge_segments),
    )


def profile_stage(path: DrivePath) -> Stage[Any, CrossSection]:
    """After the last frame: from the sweeps of the roadside to the cross-sections on the path."""
    return stage("profile", place_sections, path)


def _signs(
    s: Settings,
    m: Models,
    routes: RouteFile | None,
    path: DrivePath,
    classes: tuple[str, ...] = (),
) -> Stages:
    """Landmarks on the path, measured along a route where one is given, with codes and the next of their type."""
    segments = None
    if routes is not None and path.globe is not None:
        segments = routes.near(path.globe.route()[:, :2])
    along = s.route.milepost >= 0 or segments is not None
    return _those(
        stage("signs", place_signs, path, m.sign_confidence(s.locate.confidence)),
        stage("route", measure_along_route, path=path, settings=s.route, segments=segments)
        if along
        else None,
        stage("codes", assign_codes, settings=s.codes, classes=classes),
        stage("spacing", measure_spacing, path=path),
    )


def _those(*stages: Stage[Any, Any] | None) -> Stages:
    """The stages that a run has."""
    return [one for one in stages if one is not None]
