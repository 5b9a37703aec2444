"""Sign faces drawn into images.

Each is seen from an angle, faded, dirty, shaded and as bright as its surroundings, then blended in.
"""

import cv2
import numpy as np

from training.camera_effects import piece
from training.detector_images import FRONT
from training.face_drawings import KINDS, FaceDrawing, FaceLibrary, chosen_face
from wayside.schemas.detections import NONE
from wayside.stages.kernels import Bytes, Floats

HEIGHTS_PX = (7.0, 160.0)
"""Heights of drawn faces, log-uniform."""

BRIGHTNESS, SUNLIT_BRIGHTNESS, SUNLIT = (0.45, 1.6), (1.6, 3.0), 0.12
"""Brightness of things beside that of their surroundings; of those in the sun while the camera exposes for the shade;
fraction of these."""

LEAST_LEVEL, LENS_PX = 0.1, (0.3, 1.2)
"""Least value of white; sigma of the blur of what is brighter than the range of values, before it is cut off there: its
thin lines are lost."""

TOUCHING, SAME_COLOR = 0.2, 0.7
"""Fraction of the posts whose faces are of one kind and width and touch, as direction boards do; how often all have one
colour."""


Box = tuple[float, float, float, float]


def draw_faces(
    rgb: Bytes,
    taken: Floats,
    library: FaceLibrary,
    noise: Floats,
    rng: np.random.Generator,
    wanted: int,
) -> list[tuple[Box, FaceDrawing]]:
    """Draw up to `wanted` posts with faces into an image, in place, off the boxes `taken` (n, 4); each with its box.

    `noise` is a square of smooth noise of mean 0 and deviation 1, larger than the image, for dirt and shade.
    """
    height, width = rgb.shape[:2]
    drawn: list[tuple[Box, FaceDrawing]] = []
    boxes: list[tuple[float, ...]] = [tuple(box) for box in taken.tolist()]
    for _ in range(wanted):
        at = rng.uniform(-0.05, 0.95) * width, rng.uniform(-0.05, 0.85) * height
        drawn += _draw_assembly(rgb, at, boxes, library, noise, rng)
    return drawn


def _draw_assembly(
    rgb: Bytes,
    at: tuple[float, float],
    boxes: list[tuple[float, ...]],
    library: FaceLibrary,
    noise: Floats,
    rng: np.random.Generator,
) -> list[tuple[Box, FaceDrawing]]:
    """Draw a post with one face or more, in place, until one would lie on `boxes`; it adds its own to them.

    All are seen from one angle, in one light: below each other, touching or not, or side by side.
    """
    kind = rng.choice([name for name, _ in KINDS], p=[share for _, share in KINDS])
    face_height = float(np.exp(rng.uniform(*np.log(HEIGHTS_PX))))
    (left, top), light = at, random_brightness(rng)
    stack = 1 + int(rng.random() < 0.3) + int(rng.random() < 0.1)
    beside = stack > 1 and rng.random() < 0.35
    touching = not beside and rng.random() < TOUCHING
    stack += int(rng.integers(1, 4)) if touching else 0
    angle, color, face_width = int(rng.integers(2**32)), NONE, 0.0
    others, drawn, post_from = list(boxes), [], None
    for number in range(stack):
        alike = touching or number == 0 or kind == "back"
        drawing = chosen_face(kind if alike else "board", library, rng, color)
        rows, columns = drawing.rgba.shape[:2]
        if touching and number > 0:
            face_height = face_width * rows / columns
        if not HEIGHTS_PX[0] <= face_height <= HEIGHTS_PX[1]:
            break
        face_width = face_height * columns / rows
        if touching and rng.random() < SAME_COLOR:
            color = drawing.color
        patch = seen_from_an_angle(drawing, face_height, np.random.default_rng(angle))
        high, wide = patch.shape[:2]
        x = round(left if beside or number == 0 else left - wide / 2)
        if number == 0 and not beside:
            left = left + wide / 2
        box = (float(x), float(round(top)), float(x + wide), float(round(top) + high))
        # the margins of faces that touch overlap
        if overlaps(box, others if touching else boxes):
            break
        wear(patch, drawing.side, light, rgb, box, noise, rng)
        clipped = blend(rgb, patch, x, round(top))
        boxes.append(box)
        if clipped is not None:
            drawn.append((clipped, drawing))
        post_from = box
        if beside:
            left += wide * rng.uniform(1.0, 1.08) + 1
            face_height *= rng.uniform(0.9, 1.0)
        elif touching:
            solid = (patch[..., 3] > 0.5).any(axis=1).sum()
            top += solid + high * rng.uniform(0, 0.03)
        else:
            top += high * rng.uniform(1.0, 1.12) + 1
            face_height *= rng.uniform(0.3, 1.0)
    if post_from is not None and rng.random() < 0.6:
        _draw_post(rgb, post_from, max(top, post_from[3]), others, light, rng)
    return drawn


def overlaps(box: tuple[float, ...], others: list[tuple[float, ...]]) -> bool:
    """Whether a box has area in common with any of the others."""
    return any(
        min(box[2], b[2]) > max(box[0], b[0]) and min(box[3], b[3]) > max(box[1], b[1])
        for b in others
    )


def seen_from_an_angle(drawing: FaceDrawing, height_px: float, rng: np.random.Generator) -> Floats:
    """A face from an angle, so many pixels high; (h, w, 4) float32, colours multiplied by alpha, 0 to 1."""
    source = drawing.rgba
    rows, columns = source.shape[:2]
    yaw = np.cos(np.radians(min(abs(rng.normal(0, 22)), 65)))
    high = height_px
    wide = max(3.0, height_px * columns / rows * yaw * np.exp(rng.normal(0, 0.03)))
    shrink = max(rows / high / 2, columns / wide / 2, 1.0)
    if shrink > 1.0:
        size = max(2, round(columns / shrink)), max(2, round(rows / shrink))
        scaled = _premultiplied(source, size)
    else:
        scaled = _premultiplied(source, (columns, rows))
    rows, columns = scaled.shape[:2]
    lean, angle = rng.normal(0, 0.03), np.radians(rng.normal(0, 2.5 if rng.random() < 0.9 else 9))
    corners = np.array([[0, 0], [wide, 0], [wide, high], [0, high]])
    side = rng.normal(0, 0.03) * high
    corners += np.array([[0, -side], [0, side], [0, -side], [0, side]]) / 2
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle) + lean, np.cos(angle)]])
    corners = corners @ turn.T
    corners -= corners.min(axis=0) - rng.uniform(0.5, 1.5, 2)
    across, down = np.ceil(corners.max(axis=0)).astype(int) + 2
    flat = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], np.float32) - 0.5
    matrix = cv2.getPerspectiveTransform(flat, (corners - 0.5).astype(np.float32))
    return np.asarray(
        cv2.warpPerspective(scaled, matrix, (int(across), int(down)), flags=cv2.INTER_LINEAR),
        np.float32,
    )


def _premultiplied(rgba: Bytes, size: tuple[int, int]) -> Floats:
    values = rgba.astype(np.float32) * np.float32(1 / 255)
    values[..., :3] *= values[..., 3:]
    if size != (rgba.shape[1], rgba.shape[0]):
        values = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
    return values


def random_brightness(rng: np.random.Generator) -> float:
    """Brightness of a drawn thing beside that of its surroundings."""
    return float(rng.uniform(*(SUNLIT_BRIGHTNESS if rng.random() < SUNLIT else BRIGHTNESS)))


def wear(
    patch: Floats,
    side: int,
    light: float,
    rgb: Bytes,
    box: Box,
    noise: Floats,
    rng: np.random.Generator,
) -> None:
    """Fade, dirt, shade, brightness (`light` times that of the surroundings), blur of what is too bright, in place."""
    alpha = patch[..., 3:]
    x0, y0 = max(0, int(box[0]) - 10), max(0, int(box[1]) - 10)
    around = rgb[y0 : int(box[3]) + 10 : 3, x0 : int(box[2]) + 10 : 3]
    mean = float(around.mean()) / 255 if around.size else 0.4
    level = max((0.35 * mean + 0.45) * light, LEAST_LEVEL)
    black = level * rng.uniform(0.02, 0.2)
    fade = rng.uniform(0, 0.35) if side == FRONT else 0.0
    colors = patch[..., :3]
    grey = colors.mean(axis=2, keepdims=True)
    colors += fade * (grey - colors)
    gains = np.exp(rng.normal(0, 0.06, 3)) * (level / 0.85)
    colors *= gains.astype(np.float32)
    colors += np.float32(black) * alpha
    high, wide = patch.shape[:2]
    if rng.random() < 0.6:
        colors *= np.exp(piece(noise, (high, wide), rng) * rng.uniform(0.02, 0.25))[..., None]
    if rng.random() < 0.25:  # the edge of a shadow
        across, down = np.meshgrid(np.linspace(-1, 1, wide), np.linspace(-1, 1, high))
        angle = rng.uniform(0, 2 * np.pi)
        inside = np.cos(angle) * across + np.sin(angle) * down > rng.normal(0, 0.4)
        colors *= np.where(inside, rng.uniform(0.3, 0.8), 1.0).astype(np.float32)[..., None]
    if level > 1:
        patch[:] = cv2.GaussianBlur(patch, (0, 0), rng.uniform(*LENS_PX))


def blend(rgb: Bytes, patch: Floats, x: int, y: int) -> Box | None:
    """Put a patch at (x, y), in place; the box of what is opaque, None where less than half of it is in the image."""
    height, width = rgb.shape[:2]
    solid = patch[..., 3] > 0.5
    columns, rows = np.flatnonzero(solid.any(axis=0)), np.flatnonzero(solid.any(axis=1))
    x0, y0 = max(x, 0), max(y, 0)
    x1, y1 = min(x + patch.shape[1], width), min(y + patch.shape[0], height)
    if x0 >= x1 or y0 >= y1 or not len(columns):
        return None
    part = patch[y0 - y : y1 - y, x0 - x : x1 - x]
    below = rgb[y0:y1, x0:x1]
    below[:] = np.clip(below * (1 - part[..., 3:]) + 255 * part[..., :3], 0, 255)
    full = np.array([columns[0] + x, rows[0] + y, columns[-1] + 1 + x, rows[-1] + 1 + y], float)
    clipped = np.clip(full, 0, [width, height, width, height])
    area = np.prod(clipped[2:] - clipped[:2]) / np.prod(full[2:] - full[:2])
    return None if area < 0.5 else (clipped[0], clipped[1], clipped[2], clipped[3])


def _draw_post(
    rgb: Bytes,
    box: Box,
    top: float,
    others: list[tuple[float, ...]],
    light: float,
    rng: np.random.Generator,
) -> None:
    """A post below a face, in place, where it does not run over `others`."""
    wide, high = box[2] - box[0], box[3] - box[1]
    half = max(0.5, min(wide, high) * rng.uniform(0.02, 0.06))
    grey = float(np.clip(rng.uniform(60, 160) * light, 20, 230))
    for middle in [0.5] if wide < 2 * high else [0.2, 0.8]:
        x = box[0] + wide * middle
        x0, x1 = round(x - half), round(x + half) - (half < 1)
        y0, y1 = round(top - 1), round(top + high * rng.uniform(0.5, 6))
        if not overlaps((x0, y0, x1 + 1, y1 + 1), others):
            cv2.rectangle(rgb, (x0, y0), (x1, y1), (grey, grey * 0.99, grey * 0.97), -1)
