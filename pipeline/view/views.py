"""How each type of the flow is shown in the viewer: one function a type.

A frame's entities are sent whether there is something to show or not: an empty one clears what the frame before left.
The world is the drive's own frame: x right, y down, z ahead of the first camera, metres.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from wayside.pipeline.view import entities as at
from wayside.pipeline.view.candidates import verdict_entities
from wayside.pipeline.view.entities import Entity
from wayside.pipeline.view.landmarks import (
    HAIR,
    THIN,
    cross_section,
    face_in_image,
    landmark_color,
    landmark_points,
    landmark_words,
    rejection,
)
from wayside.pipeline.view.measured import SignMeasurement, difference_entity, measurement_entities
from wayside.pipeline.view.outlines import outline_entities
from wayside.schemas.detections import (
    SOURCES,
    Detections,
    Segmentation,
    verdict_code,
)
from wayside.schemas.frame import Camera, Frame, Image, Pose
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.motion import Motion, PosedDetections, Ties
from wayside.stages.geometry import distort_points, pair_residual, points_of_second, rays_of_ideal

RECENT = 60
"""Frames whose path and landmarks stay in view behind the vehicle."""
ITERATIONS_SHOWN = 4
"""The adjustment converges in fewer, as a rule."""
IMAGE_PLANE_M, REACH_M = 3.0, 150.0
GOOD, BAD = (90, 220, 120), (240, 90, 90)
BEFORE, AFTER = (214, 96, 10), (24, 145, 66)
"""The straight motion, and the adjusted one; in plots, whose ground the viewer's theme makes light or dark."""
JPEG_QUALITY = 85
SIFT_INK = (255, 160, 255)
KEYPOINT_PATHS = {
    "features": (at.KEYPOINTS, (120, 200, 255)),
    "sift": (at.SIFT_POINTS, SIFT_INK),
}
"""Stages that find key points: where theirs are shown, and in which colour."""
PASSED_THROUGH = {"jpeg": "image/jpeg", "jpg": "image/jpeg", "png": "image/png"}
LAST_STAGE, SIGN = "assemble", verdict_code("sign")


class NoViewError(TypeError):
    """A type of the flow has no function that shows it."""


@dataclass(slots=True)
class ViewState:
    """What is kept from frame to frame; all but the options is used by the thread of the ordered stages alone.

    `camera`: the one that was shown last. `shown`: layers that the frame before left something in. `measured`: what
    signs rest on, by their track.
    """

    images: str = "all"
    detail: bool = False
    camera: Camera | None = None
    shown: set[str] = field(default_factory=set)
    poses: dict[int, tuple[Pose, Camera]] = field(default_factory=dict)
    path: deque[NDArray[np.float64]] = field(default_factory=lambda: deque(maxlen=RECENT))
    landmarks: deque[tuple[int, Landmark]] = field(default_factory=deque)
    measured: dict[int, SignMeasurement] = field(default_factory=dict)


def entities_of(item: Any, stage: str, state: ViewState) -> tuple[Entity, ...]:
    """Entities of an item that left a stage; raises NoViewError for a type that has no view."""
    view = VIEWS.get(type(item))
    if view is None:
        raise NoViewError(
            f"no view for {type(item).__name__}: add a function to pipeline/view/views.py"
        )
    return tuple(view(item, stage, state))


def view_frame(frame: Frame, stage: str, state: ViewState) -> list[Entity]:
    """The camera, and the recorded bytes as they are; a frame that is not used says why."""
    if not frame.used or frame.camera is None:
        state.camera = None
        words = rr.TextLog(f"frame {frame.index} not used: {frame.status}", level="WARN")
        return [
            Entity(at.REJECTIONS, (words,)),
            Entity(at.VEHICLE, (rr.Clear(recursive=True),)),
        ]
    found = []
    if frame.camera != state.camera:
        state.camera = frame.camera
        found.append(Entity(at.CAMERA, (_pinhole(frame.camera),)))
    media_type = PASSED_THROUGH.get(frame.encoding)
    if media_type is not None and state.images != "none":
        found.append(
            Entity(at.IMAGE, (rr.EncodedImage(contents=bytes(frame.data), media_type=media_type),))
        )
    return found


def _pinhole(camera: Camera) -> rr.Pinhole:
    return rr.Pinhole(
        image_from_camera=camera.matrix,
        resolution=[camera.width, camera.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=IMAGE_PLANE_M,
    )


def view_image(image: Image, stage: str, state: ViewState) -> list[Entity]:
    """Images that the log holds uncompressed, compressed here; `view_frame` records all others."""
    raw = image.rgb is not None and image.frame.encoding not in PASSED_THROUGH
    if not raw or state.images == "none" or image.rgb is None:
        return []
    good, coded = cv2.imencode(
        ".jpg",
        cv2.cvtColor(image.rgb, cv2.COLOR_RGB2BGR),
        [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY],
    )
    if not good:
        return []
    return [Entity(at.IMAGE, (rr.EncodedImage(contents=coded.tobytes(), media_type="image/jpeg"),))]


def view_segmented(item: Segmentation, stage: str, state: ViewState) -> list[Entity]:
    """How many regions of each source, and dropped for each reason.

    With detail the difference image, and the label images of both passes in their own colours.
    """
    counts = np.bincount(item.regions.source, minlength=len(SOURCES))
    counted = [*counts.astype(float), *item.dropped]
    found = [Entity(f"{at.GATES}/{stage}", (rr.Scalars(counted),))]
    if (
        state.detail
        and stage == "segment"
        and item.labels is not None
        and item.image.rgb is not None
    ):
        shape = item.image.rgb.shape[:2]
        found.append(difference_entity(item.image.rgb, item.palette, item.rows))
        levels = np.linspace(40, 255, max(len(item.difference_levels) + 1, 2)).astype(np.uint8)
        inks = (item.palette.astype(np.uint8), np.repeat(levels[:, None], 3, axis=1))
        for path, labels, ink in zip(at.PASSES, item.labels, inks, strict=True):
            classes = [(i + 1, "", tuple(int(v) for v in rgb)) for i, rgb in enumerate(ink)]
            image = rr.SegmentationImage(halved_labels(labels, item.rows, shape), opacity=0.7)
            found.append(Entity(path, (rr.AnnotationContext(classes), image)))
    return found


def halved_labels(
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
    """Key points where the stage is one that finds them; else how many candidates are still open, and how many refused.

    Refused: by the stage or one before it.
    """
    if stage in KEYPOINT_PATHS:
        if not item.frame.used:
            return []
        path, ink = KEYPOINT_PATHS[stage]
        points = item.features.corners if stage == "features" else item.features.sign_points
        dots = rr.Points2D(points, colors=[ink], radii=rr.Radius.ui_points(1.5))
        return [Entity(path, (dots,))]
    left = len(item.candidates.open_rows())
    gates = Entity(f"{at.GATES}/{stage}", (rr.Scalars([left, len(item.candidates) - left]),))
    if stage != "shape" or not item.frame.used:
        return [gates]
    return [gates, *outline_entities(item, detail=state.detail)]


def view_posed(item: PosedDetections, stage: str, state: ViewState) -> list[Entity]:
    """The camera's pose and path; ties, their points by both motions, and residuals before and after adjustment."""
    frame, motion = item.frame, item.motion
    if motion is None or frame.camera is None:
        return []
    state.poses[frame.index] = (motion.pose, frame.camera)
    state.path.append(motion.pose.centre)
    found = [
        Entity(at.VEHICLE, (_transform(motion.pose),)),
        Entity(
            at.PATH,
            (rr.LineStrips3D([np.array(state.path)], colors=[(255, 255, 255)], radii=THIN),),
        ),
        *_view_ties(motion, frame.camera),
    ]
    for name, value in (
        ("straight", motion.residual_straight_px),
        ("adjusted", motion.residual_px),
    ):
        if np.isfinite(value):
            found.append(Entity(f"{at.RESIDUALS}/{name}", (rr.Scalars([value]),)))
    if motion.history_px:
        found.append(Entity(at.ITERATIONS, (rr.Scalars(residual_by_iteration(motion)),)))
    return found


def residual_by_iteration(motion: Motion) -> NDArray[np.float64]:
    """Residual (ITERATIONS_SHOWN + 1,) at the start and after each iteration; it stays as it is after the last one."""
    history = np.array(motion.history_px[: ITERATIONS_SHOWN + 1])
    return np.append(history, np.full(ITERATIONS_SHOWN + 1 - len(history), history[-1]))


def _transform(pose: Pose) -> rr.Transform3D:
    return rr.Transform3D(translation=pose.centre, mat3x3=pose.rotation)


def _view_ties(motion: Motion, camera: Camera) -> list[Entity]:
    ties = motion.ties
    if ties is None or motion.step is None:
        empty = rr.Points3D(np.zeros((0, 3)))
        return [
            Entity(at.MATCHES, (rr.LineStrips2D([]),)),
            Entity(at.POINTS_STRAIGHT, (empty,)),
            Entity(at.POINTS_ADJUSTED, (empty,)),
        ]
    ends = np.stack(
        [distort_points(camera, ties.previous), distort_points(camera, ties.current)], axis=1
    ).astype(np.float32)
    before, after = rays_of_ideal(camera, ties.previous), rays_of_ideal(camera, ties.current)
    focal = (camera.fx, camera.fy)
    step, expected = motion.step, motion.expected or motion.step
    squares = pair_residual(before, after, step.rotation, step.centre, focal)
    residual = np.sqrt(np.minimum(squares, 1e6) / 4).astype(np.float32)
    ink = np.where(ties.inlier[:, None], GOOD, BAD).astype(np.uint8)
    lines = rr.LineStrips2D(ends, colors=ink, radii=rr.Radius.ui_points(1.0))
    straight = points_of_second(before, after, expected.rotation, expected.centre)
    return [
        Entity(at.MATCHES, (lines, rr.AnyValues(residual_px=residual))),
        Entity(at.POINTS_STRAIGHT, (_cloud(straight, motion, ties, BEFORE),)),
        Entity(at.POINTS_ADJUSTED, (_cloud(ties.point, motion, ties, AFTER),)),
    ]


def _cloud(
    points: NDArray[np.float64], motion: Motion, ties: Ties, ink: tuple[int, int, int]
) -> rr.Points3D:
    with np.errstate(invalid="ignore"):
        near = ties.inlier & (np.abs(points) < REACH_M).all(axis=1)
    return rr.Points3D(motion.pose.to_world(points[near]), colors=[ink], radii=0.06)


def view_tracked(item: TrackedFrame, stage: str, state: ViewState) -> list[Entity]:
    """Candidates by verdict, tracks, rays and landmarks; of refused landmarks the reason in words."""
    frame, motion = item.frame, item.motion
    if motion is None or frame.camera is None:
        return []
    count = sum(landmark.verdict == "sign" for landmark in item.landmarks)
    signs = Entity(f"{at.GATES}/{stage}", (rr.Scalars([count]),))
    if stage != LAST_STAGE:
        return [signs]
    state.poses.setdefault(frame.index, (motion.pose, frame.camera))
    state.landmarks.extend((frame.index, landmark) for landmark in item.landmarks)
    while state.landmarks and state.landmarks[0][0] < frame.index - RECENT:
        state.landmarks.popleft()
    recent = [landmark for _, landmark in state.landmarks]
    active = active_landmarks(state, frame.index)
    return [
        signs,
        *verdict_entities(item.candidates, state.shown, detail=state.detail),
        *_view_tracks(active, frame.index, motion, frame.camera, state),
        *_view_measured(item, state),
        Entity(at.LANDMARKS, (landmark_points(recent),)),
        Entity(f"{at.LOCATION}/places", (cross_section(recent),)),
        *(
            Entity(at.REJECTIONS, (rr.TextLog(rejection(landmark), level="INFO"),))
            for landmark in item.landmarks
            if landmark.verdict != "sign"
        ),
    ]


def _view_measured(item: TrackedFrame, state: ViewState) -> list[Entity]:
    """SIFT matches, and how the landmarks first seen here were measured; those of signs are kept for the end."""
    signs = {landmark.track_id for landmark in item.landmarks if landmark.verdict == "sign"}
    kept = [m for m in item.measurements if m.track_id in signs]
    state.measured |= {m.track_id: SignMeasurement.of(m) for m in kept}
    found = []
    if item.matches is not None:
        lines = rr.LineStrips2D(item.matches.reshape(-1, 2, 2), colors=[SIFT_INK])
        found.append(Entity(at.SIFT_MATCHES, (lines,)))
    if item.measurements:
        found += measurement_entities(item.measurements)
        state.shown.add(at.PANELS)
    elif at.PANELS in state.shown:
        found += [Entity(path, (rr.Clear(recursive=True),)) for path in (at.PANELS, at.MOVED)]
        state.shown.discard(at.PANELS)
    return found


def active_landmarks(state: ViewState, index: int) -> list[Landmark]:
    """Recent landmarks that a frame was measured in."""
    return [p for _, p in state.landmarks if any(view.frame == index for view in p.views)]


def _view_tracks(
    active: list[Landmark], index: int, motion: Motion, camera: Camera, state: ViewState
) -> list[Entity]:
    strips, inks, faces, labels, rays = [], [], [], [], []
    for landmark in active:
        centre = landmark.best_pose.to_world(landmark.position)
        ink = landmark_color(landmark)
        until_now = [view for view in landmark.views if view.frame <= index]
        strips.append(distort_points(camera, np.array([(v.u_px, v.v_px) for v in until_now])))
        inks.append(ink)
        rays.append(np.stack([motion.pose.centre, centre]))
        faces.append(face_in_image(landmark, motion.pose, camera))
        labels.append(landmark_words(landmark))
    signs = rr.LineStrips2D(
        faces,
        colors=inks or None,
        labels=labels or None,
        show_labels=False,
        radii=THIN,
    )
    return [
        Entity(at.TRACKS, (rr.LineStrips2D(strips, colors=inks or None, radii=HAIR),)),
        Entity(at.REPROJECTED, (signs,)),
        Entity(at.RAYS, (rr.LineStrips3D(rays, colors=inks or None, radii=THIN),)),
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
