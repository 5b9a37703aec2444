"""Made-up input of the stages, changes to it, and what tracking made of it.

A drive past flat panels with exact truth (boxes, motion and candidates without images), and images of random texture.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from wayside.pipeline.models.model_folder import shipped_models
from wayside.pipeline.models.model_json import model_from_json
from wayside.schemas.detections import (
    COLORS,
    SHAPES,
    VERDICTS,
    Candidates,
    Detections,
    Features,
    Regions,
    verdict_code,
)
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image
from wayside.schemas.motion import PosedDetections
from wayside.stages.geometry import box_areas
from wayside.stages.segmentation import unsegmented

from ..made_landmarks import made_motion

FINER = 16
OUTLINE_MODEL = model_from_json((shipped_models() / "outline.json").read_text())
"""The model of outlines that ships."""
CAMERA = Camera(1600, 1200, 1400.0, 1400.0, 799.5, 599.5)
DISTORTED = Camera(640, 480, 560.0, 560.0, 320.0, 240.0, (-0.15, 0.08, 0.0, 0.0005, -0.02))
SPACING = 8.0
STEP_SIGMA = [1e-4, 1e-4, 1e-4, 0.01, 0.005, 0.02]


@dataclass(frozen=True)
class Panel:
    """A panel facing the camera; centre right of, above and along the path of the camera, metres."""

    right: float
    up: float
    along: float
    wide: float = 0.75
    tall: float = 0.75
    speed: float = 0.0  # metres a frame along the path, and how it changes in a frame
    change: float = 0.0
    score: float = 3.0
    hidden_in: tuple[int, ...] = ()
    only_in: tuple[int, ...] | None = None


def boxes_of(panels, frame):
    """Panels that lie in the image of a frame and are at least 6 px tall, with their boxes."""
    found = []
    for panel in panels:
        z = panel.along + (panel.speed + panel.change * frame / 2 - SPACING) * frame
        if z < 3 or frame in panel.hidden_in or (panel.only_in and frame not in panel.only_in):
            continue
        u, v = CAMERA.cx + CAMERA.fx * panel.right / z, CAMERA.cy - CAMERA.fy * panel.up / z
        wide, tall = CAMERA.fx * panel.wide / z, CAMERA.fy * panel.tall / z
        box = [u - wide / 2 + 0.5, v - tall / 2 + 0.5, u + wide / 2 + 0.5, v + tall / 2 + 0.5]
        if box[0] >= 0 and box[1] >= 0 and box[2] <= 1600 and box[3] <= 1200 and tall >= 6:
            found.append((panel, box))
    return found


def moved_frame(index, panels, *, used=True, step=0):
    """One frame of a straight drive; `step` counts the used frames."""
    seen = boxes_of(panels, step) if used else []
    box = np.array([b for _, b in seen], np.float32).reshape(-1, 4)
    n = len(box)
    table = replace(
        Candidates.of(made_regions(box, area_px=100)),
        score=np.array([p.score for p, _ in seen], np.float32),
        color=np.full(n, COLORS.index("yellow"), np.int8),
        color_distance=np.ones(n, np.float32),
        shape=np.full(n, SHAPES.index("rectangle"), np.int8),
        shape_distance=np.ones(n, np.float32),
    )
    frame = Frame(
        index, index * 10**9, None, USED if used else THINNED, "jpeg", b"", CAMERA, 1600, 1200
    )
    # A descriptor for each panel: the same in every frame.
    codes = np.random.default_rng(5).random((len(panels), 132)).astype(np.float32)
    which = [panels.index(p) for p, _ in seen]
    features = replace(Features.empty(), sign_descriptors=codes[which].reshape(-1, 132))
    segmentation = replace(unsegmented(Image(frame, None, None)), region_count=n, rows=(0, 1200))
    detections = Detections(segmentation, table, features)
    motion = made_motion(step, np.diag(STEP_SIGMA) ** 2, camera_height_m=1.6)
    return PosedDetections(detections, motion if used else None)


def made_regions(boxes, rgb=(0, 0, 0), area_px=90):
    """Regions of these boxes, all alike otherwise."""
    box = np.array(boxes, np.float32).reshape(-1, 4)
    n, color = len(box), np.array([rgb], np.float32)
    return Regions(box, np.full(n, area_px, np.int32), color.repeat(n, 0), np.zeros(n, np.uint8))


def made_image(rgb, index=0, status=USED, camera=None):
    """An image of these pixels, or without them where it is not used."""
    height, width = rgb.shape[:2]
    frame = Frame(index, 1000 + index, None, status, "jpeg", b"", camera, width, height)
    used = status == USED
    return Image(frame, rgb if used else None, rgb[..., 0] if used else None)


def with_candidates(posed, **columns):
    """The frame with other columns of its candidates."""
    table = replace(posed.detections.candidates, **columns)
    return replace(posed, detections=replace(posed.detections, candidates=table))


def with_image(posed, rgb):
    """The frame with these pixels."""
    detections = posed.detections
    image = replace(detections.image, rgb=rgb, grey=rgb[..., 0])
    segmentation = replace(detections.segmentation, image=image)
    return replace(posed, detections=replace(detections, segmentation=segmentation))


def landmarks_of(tracked):
    return [landmark for item in tracked for landmark in item.landmarks]


def verdicts_of(tracked):
    return [VERDICTS[v] for item in tracked for v in item.candidates.verdict]


def paint(image, pose, camera, polygons):
    """Fill polygons, each points (n, 3) of the world and a colour; edges are as soft as a camera's."""
    local = [pose.to_camera(points) for points, _ in polygons]
    if min(points[:, 2].min() for points in local) < 3:
        return
    pixels = [p[:, :2] / p[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy) for p in local]
    every = np.concatenate(pixels)
    left, top = np.maximum(np.floor(every.min(axis=0)).astype(int) - 4, 0)
    right, bottom = np.ceil(every.max(axis=0)).astype(int) + 5
    cut = image[top : max(bottom, 0), left : max(right, 0)]
    if not cut.size:
        return
    large = cv2.resize(cut, None, fx=FINER, fy=FINER)
    for corners, (_, color) in zip(pixels, polygons, strict=True):
        at = ((corners - (left, top) + 0.5) * FINER - 0.5) * 16
        cv2.fillPoly(large, [np.round(at).astype(np.int32)], color, shift=4)
    cut[:] = cv2.resize(large, cut.shape[1::-1], interpolation=cv2.INTER_AREA)


def stamp(image, patch, scale, middle):
    """Draw a grey patch, so many times as large, with its middle at a place (u, v) of a grey image."""
    shift = np.array(middle) - scale * (np.array(patch.shape[::-1]) - 1) / 2
    warp = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    size, around = image.shape[::-1], cv2.BORDER_TRANSPARENT
    cv2.warpAffine(patch, warp, size, dst=image, flags=cv2.INTER_AREA, borderMode=around)


def drive(panels, frames, unused=()):
    """Frames of a straight drive past panels; `unused` are indices of frames that take no part."""
    steps = np.cumsum([index not in unused for index in range(frames)]) - 1
    return [moved_frame(i, panels, used=i not in unused, step=int(steps[i])) for i in range(frames)]


def texture(height=480, width=640, seed=0, contrast=60.0):
    """A grey image of blurred noise."""
    noise = np.random.default_rng(seed).normal(0, 1, (height, width)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.clip(128 + contrast * blurred / blurred.std(), 0, 255).astype(np.uint8)


def detections_of(grey, boxes=(), verdicts=(), status=USED):
    """The detections of a grey image (480, 640), or of a frame without one."""
    box = np.array(boxes, np.float32).reshape(-1, 4)
    candidates = Candidates.of(made_regions(box, area_px=box_areas(box)))
    if len(verdicts):
        candidates.verdict[:] = [verdict_code(name) for name in verdicts]
    frame = Frame(3, 0, None, status, "jpeg", b"", DISTORTED, 640, 480)
    image = Image(frame, None if grey is None else np.dstack([grey] * 3), grey)
    known = {"regions": candidates.regions, "region_count": len(box), "rows": (100, 300)}
    return Detections(replace(unsegmented(image), **known), candidates)
