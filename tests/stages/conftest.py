"""Made-up input of the stages.

A drive past flat panels with exact truth (boxes, motion and candidates without images), and images of random texture.
"""

from dataclasses import dataclass, replace
from importlib.resources import files

import cv2
import numpy as np
import pytest

from wayside.pipeline.models.model_json import model_from_json
from wayside.schemas.detections import (
    COLORS,
    SHAPES,
    Candidates,
    Detections,
    Features,
    verdict_code,
)
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image
from wayside.schemas.models import LinearModel
from wayside.schemas.motion import PosedDetections
from wayside.stages.geometry import box_areas
from wayside.stages.segmentation import unsegmented

from ..made_landmarks import made_motion
from .made_frames import made_regions

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
    features = Features(
        *(np.zeros((0, 2), np.float32), np.zeros((0, 32), np.uint8), np.zeros((n, 2), np.float32)),
        *(codes[which].reshape(-1, 132), np.arange(n, dtype=np.int32)),
    )
    segmentation = replace(unsegmented(Image(frame, None, None)), region_count=n, rows=(0, 1200))
    detections = Detections(segmentation, table, features)
    motion = made_motion(step, np.diag(STEP_SIGMA) ** 2, camera_height_m=1.6)
    return PosedDetections(detections, motion if used else None)


@pytest.fixture(scope="session")
def outline_model():
    """The model of outlines that ships."""
    text = (files("wayside.pipeline") / "models" / "outline.json").read_text()
    model = model_from_json(text)
    assert isinstance(model, LinearModel)
    return model


@pytest.fixture
def panel():
    return Panel


@pytest.fixture
def drive():
    """Frames of a straight drive past panels; `unused` are indices of frames that take no part."""

    def make(panels, frames, unused=()):
        steps = np.cumsum([index not in unused for index in range(frames)]) - 1
        return [
            moved_frame(i, panels, used=i not in unused, step=int(steps[i])) for i in range(frames)
        ]

    return make


@pytest.fixture
def texture():
    """Makes a grey image of blurred noise: `texture(height=480, width=640, seed=0, contrast=60.0)`."""

    def make(height=480, width=640, seed=0, contrast=60.0):
        noise = np.random.default_rng(seed).normal(0, 1, (height, width)).astype(np.float32)
        blurred = cv2.GaussianBlur(noise, (0, 0), 2.5)
        return np.clip(128 + contrast * blurred / blurred.std(), 0, 255).astype(np.uint8)

    return make


@pytest.fixture
def detections_of():
    """Makes the detections of a grey image (480, 640) or of a frame without one: `detections_of(grey, boxes)`."""

    def make(grey, boxes=(), verdicts=(), status=USED):
        box = np.array(boxes, np.float32).reshape(-1, 4)
        candidates = Candidates.of(made_regions(box, area_px=box_areas(box)))
        if len(verdicts):
            candidates.verdict[:] = [verdict_code(name) for name in verdicts]
        frame = Frame(3, 0, None, status, "jpeg", b"", DISTORTED, 640, 480)
        image = Image(frame, None if grey is None else np.dstack([grey] * 3), grey)
        known = {"regions": candidates.regions, "region_count": len(box), "rows": (100, 300)}
        return Detections(replace(unsegmented(image), **known), candidates)

    return make
