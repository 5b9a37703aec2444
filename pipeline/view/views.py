"""How each type of the flow is shown in the viewer: one function a type.

A frame's entities are sent whether there is something to show or not: an empty one clears what the frame before left.
The world is the drive's own frame: x right, y down, z ahead of the first camera, metres.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from wayside.pipeline.files.pictures import blurred
from wayside.pipeline.view import entities as at
from wayside.pipeline.view.drawing import (
    BAD,
    GOOD,
    HAIR,
    THIN,
    WHITE,
    Ink,
    candidate_entities,
    centre_of,
    colored,
    cross_section,
    encoded,
    face_in_image,
    outline_entities,
    panel_pictures,
    rejection,
)
from wayside.pipeline.view.entities import Entity, cleared
from wayside.schemas.detections import SOURCES, Detections, Segmentation, verdict_code
from wayside.schemas.frame import Camera, Frame, Image, Pose
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.measurement import Measurement
from wayside.schemas.motion import Motion, PosedDetections, Ties
from wayside.stages.geometry import distort_points, pair_residual, points_of_second, rays_of_ideal
from wayside.stages.odometry import root_mean
from wayside.stages.segmentation import nearest_centers

RECENT = 60
"""Frames whose path and landmarks stay in view behind the vehicle."""
ITERATIONS_SHOWN = 4
"""The adjustment converges in fewer, as a rule."""
IMAGE_PLANE_M, REACH_M = 3.0, 150.0
BEFORE, AFTER = (214, 96, 10), (24, 145, 66)
"""The straight motion, and the adjusted one; in plots, whose ground the viewer's theme makes light or dark."""
MOVED_INK = (245, 150, 60)
JPEG_QUALITY, DIFFERENCE_QUALITY = 85, 92
SIFT_INK = (255, 160, 255)
KEYPOINT_PATHS = {"features": (at.KEYPOINTS, (120, 200, 255)), "sift": (at.SIFT_POINTS, SIFT_INK)}
"""Stages that find key points: where theirs are shown, and in which colour."""
PASSED_THROUGH = {"jpeg": "image/jpeg", "jpg": "image/jpeg", "png": "image/png"}
LAST_STAGE, SIGN = "assemble", verdict_code("sign")


@dataclass(slots=True)
class ViewState:
    """What is kept from frame to frame; except the options, only the thread of the ordered stages uses it."""

    images: str = "all"
    detail: bool = False
    blur: bool = False
    camera: Camera | None = None
    """The one that was shown last."""
    shown: set[str] = field(default_factory=set)
    """Layers that the frame before left something in."""
    poses: dict[int, tuple[Pose, Camera]] = field(default_factory=dict)
    path: deque[NDArray[np.float64]] = field(default_factory=lambda: deque(maxlen=RECENT))
    landmarks: deque[tuple[int, Landmark]] = field(default_factory=deque)
    measured: dict[int, tuple[dict[str, Any], tuple[float, ...]]] = field(default_factory=dict)
    """Pictures of the panel of each sign by track, and its residuals by iteration."""


def entities_of(item: Any, stage: str, state: ViewState) -> tuple[Entity, ...]:
    """Entities of an item that left a stage; raises TypeError for a type that has no view."""
    view = VIEWS.get(type(item))
    if view is None:
        raise TypeError(f"no view for {type(item).__name__}: add one to pipeline/view/views.py")
    return tuple(view(item, stage, state))


def view_frame(frame: Frame, stage: str, state: ViewState) -> list[Entity]:
    """The camera, and the recorded bytes as they are; a frame that is not used says why."""
    if not frame.used or frame.camera is None:
        state.camera = None
        words = rr.TextLog(f"frame {frame.index} not used: {frame.status}", level="WARN")
        return [Entity(at.REJECTIONS, words), cleared(at.VEHICLE, recursive=True)]
    found = []
    if frame.camera != state.camera:
        camera = state.camera = frame.camera
        pinhole = rr.Pinhole(
            image_from_camera=camera.matrix,
            resolution=[camera.width, camera.height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=IMAGE_PLANE_M,
        )
        found.append(Entity(at.CAMERA, pinhole))
    media_type = PASSED_THROUGH.get(frame.encoding)
    if media_type is not None and state.images != "none" and not state.blur:
        found.append(Entity(at.IMAGE, encoded(frame.data, media_type)))
    return found


def view_image(image: Image, stage: str, state: ViewState) -> list[Entity]:
    """Images that the log holds uncompressed, compressed here; `view_frame` records all others."""
    held = image.frame.encoding in PASSED_THROUGH or state.blur
    if held or state.images == "none" or image.rgb is None:
        return []
    return [Entity(at.IMAGE, rr.Image(image.rgb).compress(jpeg_quality=JPEG_QUALITY))]


def view_segmented(item: Segmentation, stage: str, state: ViewState) -> list[Entity]:
    """How many regions of each source, and dropped for each reason.

    With detail the difference image (report chapter 2.3), and the label images of both passes in their own colours.
    """
    counts = np.bincount(item.regions.source, minlength=len(SOURCES))
    found = [Entity(f"{at.GATES}/{stage}", rr.Scalars([*counts.astype(float), *item.dropped]))]
    rgb = item.image.rgb
    if not state.detail or stage != "segment" or item.labels is None or rgb is None:
        return found
    full, (top, bottom) = np.zeros(rgb.shape[:2], np.uint8), item.rows
    differences = nearest_centers(rgb[top:bottom], np.rint(item.palette))[1]
    full[top:bottom] = np.minimum(differences, 255)
    found.append(Entity(at.DIFFERENCE, rr.Image(full).compress(jpeg_quality=DIFFERENCE_QUALITY)))
    levels = np.linspace(40, 255, max(len(item.difference_levels) + 1, 2)).astype(np.uint8)
    inks = (item.palette.astype(np.uint8), np.repeat(levels[:, None], 3, axis=1))
    for path, labels, ink in zip(at.PASSES, item.labels, inks, strict=True):
        classes = [(i + 1, "", tuple(int(v) for v in rgb)) for i, rgb in enumerate(ink)]
        image = rr.SegmentationImage(_halved_labels(labels, item.rows, full.shape), opacity=0.7)
        found.append(Entity(path, rr.AnnotationContext(classes), image))
    return found


def _halved_labels(
    labels: NDArray[np.uint8], rows: tuple[int, int], shape: tuple[int, ...]
) -> NDArray[np.uint8]:
    """Labels + 1 of every second pixel, spread over the image (0 where not segmented).

    Doubled again so that they cover the image; pairs of equal pixels compress to half the size.
    """
    full = np.zeros(shape, np.uint8)
    half = labels[::2, ::2] + np.uint8(1)
    twice = half.repeat(2, axis=0).repeat(2, axis=1)
    full[rows[0] : rows[1]] = twice[: labels.shape[0], : labels.shape[1]]
    return full


def view_detections(item: Detections, stage: str, state: ViewState) -> list[Entity]:
    """Key points if the stage finds them; else how many candidates are still open, and how many are not."""
    rows = item.candidates.open_rows()
    if stage in KEYPOINT_PATHS:
        if not item.frame.used:
            return []
        path, ink = KEYPOINT_PATHS[stage]
        points = item.features.corners if stage == "features" else item.candidates.center[rows]
        return [Entity(path, rr.Points2D(points, colors=[ink], radii=THIN))]
    gates = Entity(f"{at.GATES}/{stage}", rr.Scalars([len(rows), len(item.candidates) - len(rows)]))
    if stage != "shape" or not item.frame.used:
        return [gates]
    return [gates, *outline_entities(item, detail=state.detail)]


def view_posed(item: PosedDetections, stage: str, state: ViewState) -> list[Entity]:
    """The camera's pose and path; ties, their points by both motions, and residuals before and after adjustment."""
    frame, motion = item.frame, item.motion
    if motion is None or frame.camera is None:
        return []
    pose = motion.pose
    state.poses[frame.index] = (pose, frame.camera)
    state.path.append(pose.centre)
    path = rr.LineStrips3D([np.array(state.path)], colors=[WHITE], radii=THIN)
    found = [
        Entity(at.VEHICLE, rr.Transform3D(translation=pose.centre, mat3x3=pose.rotation)),
        Entity(at.PATH, path),
        *_view_ties(motion, frame.camera),
    ]
    candidates, rgb = item.detections.candidates, item.detections.image.rgb
    if state.blur and state.images != "none" and rgb is not None:
        hidden = blurred(rgb, candidates.regions.box[candidates.open_rows()])
        found.append(Entity(at.IMAGE, rr.Image(hidden).compress(jpeg_quality=JPEG_QUALITY)))
    if motion.history_px:
        shown = np.array(motion.history_px[: ITERATIONS_SHOWN + 1])  # the last one stays
        padded = np.pad(shown, (0, ITERATIONS_SHOWN + 1 - len(shown)), mode="edge")
        found.append(Entity(at.ITERATIONS, rr.Scalars(padded)))
    return found


def _view_ties(motion: Motion, camera: Camera) -> list[Entity]:
    ties, step, line = motion.ties, motion.step, motion.straight
    if ties is None or step is None or line is None:
        return [cleared(one) for one in (at.MATCHES, at.POINTS_STRAIGHT, at.POINTS_ADJUSTED)]
    points = [distort_points(camera, ends) for ends in (ties.previous, ties.current)]
    ends = np.stack(points, axis=1).astype(np.float32)
    before, after = rays_of_ideal(camera, ties.previous), rays_of_ideal(camera, ties.current)
    squares = {
        name: pair_residual(before, after, one.rotation, one.centre, (camera.fx, camera.fy))
        for name, one in (("straight", line), ("adjusted", step))
    }
    residual = np.sqrt(np.minimum(squares["adjusted"], 1e6) / 4).astype(np.float32)
    ink = np.where(ties.inlier[:, None], GOOD, BAD).astype(np.uint8)
    lines = rr.LineStrips2D(ends, colors=ink, radii=rr.Radius.ui_points(1.0))
    straight = points_of_second(before, after, line.rotation, line.centre)
    return [
        *(
            Entity(f"{at.RESIDUALS}/{name}", rr.Scalars([value]))
            for name, own in squares.items()
            if np.isfinite(value := root_mean(own[ties.inlier]))
        ),
        Entity(at.MATCHES, lines, rr.AnyValues(residual_px=residual)),
        Entity(at.POINTS_STRAIGHT, _cloud(straight, motion, ties, BEFORE)),
        Entity(at.POINTS_ADJUSTED, _cloud(ties.point, motion, ties, AFTER)),
    ]


def _cloud(points: NDArray[np.float64], motion: Motion, ties: Ties, ink: Ink) -> rr.Points3D:
    with np.errstate(invalid="ignore"):
        near = ties.inlier & (np.abs(points) < REACH_M).all(axis=1)
    return rr.Points3D(motion.pose.to_world(points[near]), colors=[ink], radii=0.06)


def view_tracked(item: TrackedFrame, stage: str, state: ViewState) -> list[Entity]:
    """Candidates by verdict, tracks, rays and landmarks; of refused landmarks the reason in words."""
    frame, motion = item.frame, item.motion
    if motion is None or frame.camera is None:
        return []
    count = sum(landmark.verdict == "sign" for landmark in item.landmarks)
    signs = Entity(f"{at.GATES}/{stage}", rr.Scalars([count]))
    if stage != LAST_STAGE:
        return [signs]
    state.poses.setdefault(frame.index, (motion.pose, frame.camera))
    state.landmarks.extend((frame.index, landmark) for landmark in item.landmarks)
    while state.landmarks and state.landmarks[0][0] < frame.index - RECENT:
        state.landmarks.popleft()
    recent = [landmark for _, landmark in state.landmarks]
    centres = np.array([centre_of(one) for one in recent]).reshape(-1, 3)
    points = rr.Points3D(centres, radii=rr.Radius.ui_points(3), **colored(recent))
    refused = [one for one in item.landmarks if one.verdict != "sign"]
    return [
        signs,
        *candidate_entities(item.candidates, state.shown, detail=state.detail),
        *_view_tracks(frame.index, motion, frame.camera, state),
        *_view_measured(item, state),
        Entity(at.LANDMARKS, points),
        Entity(f"{at.LOCATION}/places", cross_section(recent)),
        *(Entity(at.REJECTIONS, rr.TextLog(rejection(one), level="INFO")) for one in refused),
    ]


def active_landmarks(state: ViewState, index: int) -> list[Landmark]:
    """Recent landmarks that a frame was measured in."""
    return [p for _, p in state.landmarks if any(view.frame == index for view in p.views)]


def _view_tracks(index: int, motion: Motion, camera: Camera, state: ViewState) -> list[Entity]:
    active = active_landmarks(state, index)
    looks = colored(active)
    until_now = [[v for v in one.views if v.frame <= index] for one in active]
    tracks = [
        distort_points(camera, np.array([(v.u_px, v.v_px) for v in views])) for views in until_now
    ]
    faces = [face_in_image(one, motion.pose, camera) for one in active]
    # of rows without a confidence, those that are refused are thousands
    known = [one for one in active if one.verdict == "sign" or np.isfinite(one.score)]
    rays = [np.stack([motion.pose.centre, centre_of(one)]) for one in known]
    return [
        Entity(at.TRACKS, rr.LineStrips2D(tracks, colors=looks["colors"], radii=HAIR)),
        Entity(at.REPROJECTED, rr.LineStrips2D(faces, radii=THIN, **looks)),
        Entity(at.RAYS, rr.LineStrips3D(rays, colors=colored(known)["colors"], radii=THIN)),
    ]


def _view_measured(item: TrackedFrame, state: ViewState) -> list[Entity]:
    """SIFT matches, and how the landmarks first seen here were measured; those of signs are kept for the end."""
    signs = {landmark.track_id for landmark in item.landmarks if landmark.verdict == "sign"}
    for one in item.measurements:
        if one.track_id in signs:
            history = () if one.adjustment is None else one.adjustment.history_sigmas
            state.measured[one.track_id] = (panel_pictures([one]), history)
    found = []
    if item.matches is not None:
        lines = rr.LineStrips2D(item.matches.reshape(-1, 2, 2), colors=[SIFT_INK])
        found.append(Entity(at.SIFT_MATCHES, lines))
    if item.measurements:
        pictures = panel_pictures(item.measurements)
        found += [Entity(f"{at.PANELS}/{name}", picture) for name, picture in pictures.items()]
        found += _view_adjusted(item.measurements)
        state.shown.add(at.PANELS)
    elif at.PANELS in state.shown:
        found += [cleared(path, recursive=True) for path in (at.PANELS, at.MOVED)]
        state.shown.discard(at.PANELS)
    return found


def _view_adjusted(measurements: Sequence[Measurement]) -> list[Entity]:
    """The residual of the windowed adjustment before and after, and how far it moved each landmark."""
    adjusted = [(m.track_id, m.adjustment) for m in measurements if m.adjustment is not None]
    if not adjusted:
        return []
    squares = [(a.history_sigmas[0] ** 2, a.history_sigmas[-1] ** 2) for _, a in adjusted]
    before, after = np.sqrt(np.mean(squares, axis=0))
    words = [
        f"track {track}: residual {a.history_sigmas[0]:.2f} to {a.history_sigmas[-1]:.2f} sigmas in "
        f"{len(a.history_sigmas) - 1} iterations over frames {a.first_frame} to {a.last_frame}, moved "
        f"{float(np.linalg.norm(a.position - a.start)):.2f} m"
        for track, a in adjusted
    ]
    moved = rr.LineStrips3D(
        [np.stack([a.start, a.position]) for _, a in adjusted],
        colors=[MOVED_INK],
        labels=words,
        show_labels=False,
        radii=THIN,
    )
    return [
        Entity(f"{at.WINDOW_RESIDUALS}/before", rr.Scalars([before])),
        Entity(f"{at.WINDOW_RESIDUALS}/after", rr.Scalars([after])),
        Entity(at.MOVED, moved),
    ]


VIEWS: dict[type, Callable[[Any, str, ViewState], list[Entity]]] = {
    Frame: view_frame,
    Image: view_image,
    Segmentation: view_segmented,
    Detections: view_detections,
    PosedDetections: view_posed,
    TrackedFrame: view_tracked,
}
"""Every type of the flow."""
