"""How landmarks, candidates, outlines and measured panels are drawn: colours, words and archetypes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.view import entities as at
from wayside.pipeline.view.entities import Entity, cleared
from wayside.schemas.detections import COLOR_RGB, COLORS, SHAPES, VERDICTS, Candidates, Detections
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.landmarks import Landmark
from wayside.schemas.measurement import Measurement
from wayside.stages.geometry import distort_points
from wayside.stages.panel import face_corners, warp_to_template
from wayside.stages.report import TERMS, outlines_of

Ink = tuple[int, int, int]
GREY, WHITE = (150, 150, 150), (255, 255, 255)
"""Grey: what is no sign, or has no colour."""
GOOD, BAD = (90, 220, 120), (240, 90, 90)
HIGH_RESIDUAL_PX = 2.0
"""Residual from which a row without confidence is drawn in `BAD`: on the demo drive one in twenty has more."""
THIN, HAIR = rr.Radius.ui_points(1.5), rr.Radius.ui_points(0.75)
PIXEL_CENTRE = 0.5
"""The centre of the first pixel in the viewer; elsewhere it is 0."""
BLOB = pa.list_(pa.field("item", pa.uint8(), nullable=False))
MANY, MOST_WORDS = ("size", "color"), 100
"""Verdicts of thousands of regions: their boxes are detail. Words for more boxes than this are not made."""
CURVES = {"circle": (1,), "ellipse": (1, -1), "six_terms": (1, *TERMS[:6])}
"""Fourier terms beside the mean that each curve is made of: one is a circle, with its conjugate an ellipse."""
INKS = {
    "traced": (255, 255, 255),
    "circle": (245, 150, 60),
    "ellipse": (90, 200, 245),
    "six_terms": (240, 90, 200),
}
_NEAREST_M = 0.5
_GAP_PX, _QUALITY = 4, 92
"""Pixels between views in a picture of several, and quality of its JPEG."""


def landmark_color(landmark: Landmark) -> Ink:
    """Colour to draw a landmark in: of a sign its own, or by residual (unknown: high) where it has no confidence."""
    if landmark.verdict != "sign" or np.isfinite(landmark.score):
        return COLOR_RGB.get(landmark.color or "", GREY) if landmark.verdict == "sign" else GREY
    part = min(float(np.nan_to_num(landmark.residual_px / HIGH_RESIDUAL_PX, nan=1.0)), 1.0)
    red, green, blue = (round(a + part * (b - a)) for a, b in zip(GOOD, BAD, strict=True))
    return red, green, blue


def colored(landmarks: Sequence[Landmark]) -> dict[str, Any]:
    """Colours and hidden words of landmarks, as archetypes take them."""
    return {
        "colors": [landmark_color(one) for one in landmarks] or None,
        "labels": [landmark_words(one) for one in landmarks] or None,
        "show_labels": False,
    }


def landmark_words(landmark: Landmark) -> str:
    """A landmark in a few words."""
    return f"{_appearance(landmark)}, {landmark.verdict}, track {landmark.track_id}"


def _appearance(landmark: Landmark) -> str:
    kind = "back" if landmark.back else (landmark.color or "?").replace("_", " ")
    return f"{kind} {landmark.shape or '?'} {landmark.width_m:.2f} x {landmark.height_m:.2f} m"


def rejection(landmark: Landmark) -> str:
    """Why a landmark is no sign, in words; the numbers that decided come first, as a narrow list cuts the rest.

    Terms of the evidence are log-likelihood ratios, the weakest first.
    """
    score = f"; score {landmark.score:.1f}" if np.isfinite(landmark.score) else ""
    weakest_first = sorted(landmark.evidence, key=lambda term: term[1])
    evidence = "".join(f", {term} {ratio:+.1f}" for term, ratio in weakest_first)
    return (
        f"{landmark.verdict}: {_appearance(landmark)}{score}{evidence}; "
        f"{landmark.right_m:+.1f} m right, {landmark.above_m:+.1f} m above the camera, "
        f"station {landmark.station_m:.1f} m, {len(landmark.views)} views, "
        f"residual {landmark.residual_px:.2f} px, track {landmark.track_id}"
    )


def centre_of(landmark: Landmark) -> NDArray[np.float64]:
    """Centre (3,) of a landmark in the drive's frame."""
    return landmark.best_pose.to_world(landmark.position)


def panel_rotation(landmark: Landmark) -> NDArray[np.float64]:
    """Axes (3, 3) of a landmark's panel in the drive's frame: right, down, away; facing the camera where not known."""
    angle = np.radians(np.nan_to_num(landmark.facing_deg))
    about_down = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    return np.asarray(landmark.best_pose.rotation @ about_down)


def face_in_image(landmark: Landmark, pose: Pose, camera: Camera) -> NDArray[np.float64]:
    """The outline of a landmark's face projected into an image, closed.

    Points (n, 2) in the viewer's pixels, from the upper left corner of the image; none with a corner behind the camera.
    """
    half = np.array([landmark.width_m, landmark.height_m]) / 2
    flat = face_corners(landmark.shape) * half
    offsets = np.column_stack([flat, np.zeros(len(flat))]) @ panel_rotation(landmark).T
    local = pose.to_camera(centre_of(landmark) + offsets)
    if (local[:, 2] < _NEAREST_M).any():
        return np.zeros((0, 2))
    ideal = local[:, :2] / local[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    pixels = distort_points(camera, ideal) + PIXEL_CENTRE
    return np.concatenate([pixels, pixels[:1]])


def across_the_road(points: Any) -> NDArray[np.float64]:
    """Points right, above (n, 2) as an image, which counts downwards."""
    return np.asarray(points, np.float64).reshape(-1, 2) * (1.0, -1.0)


def cross_section(landmarks: Sequence[Landmark], names: Sequence[str] = ()) -> rr.Points2D:
    """Landmarks in the plane across the road, with words or names."""
    places = across_the_road([(one.right_m, one.above_m) for one in landmarks])
    looks = colored(landmarks) | ({"labels": names} if names else {})
    return rr.Points2D(places, radii=rr.Radius.ui_points(4), **looks)


def candidate_entities(candidates: Candidates, shown: set[str], *, detail: bool) -> list[Entity]:
    """Boxes of every verdict; `shown` are the layers that the frame before left something in, changed here."""
    found = []
    for code, verdict in enumerate(VERDICTS):
        path = f"{at.CANDIDATES}/{verdict}"
        rows = np.flatnonzero(candidates.verdict == code)
        if len(rows) and (detail or verdict not in MANY):
            found.append(Entity(path, *_boxes(candidates, rows, verdict)))
            shown.add(path)
        elif path in shown:
            found.append(cleared(path))
            shown.discard(path)
    return found


def _boxes(candidates: Candidates, rows: NDArray[np.int64], verdict: str) -> tuple[Any, ...]:
    sign, many = verdict == "sign", verdict in MANY or len(rows) > MOST_WORDS
    inks = [COLOR_RGB[COLORS[c]] if c >= 0 else GREY for c in candidates.color[rows]]
    boxes = rr.Boxes2D(
        array=candidates.regions.box[rows],
        array_format=rr.Box2DFormat.XYXY,
        colors=inks if sign else [GREY],
        labels=None if many else [candidate_words(candidates, int(row)) for row in rows],
        show_labels=False,  # of some presets, hundreds would cover the image
        radii=THIN if sign else rr.Radius.ui_points(0.7),
    )
    return (boxes, rr.AnyValues(score=candidates.score[rows])) if many else (boxes,)


def candidate_words(candidates: Candidates, row: int) -> str:
    """Words for a candidate: verdict, score, colour and shape, in preset `report` with their distances."""
    parts = [VERDICTS[candidates.verdict[row]]]
    if np.isfinite(candidates.score[row]):
        parts.append(f"score {candidates.score[row]:.1f}")
    if candidates.back_score is not None and np.isfinite(candidates.back_score[row]):
        parts.append(f"back {candidates.back_score[row]:.1f}")
    for names, kind, distance in (
        (COLORS, candidates.color, candidates.color_distance),
        (SHAPES, candidates.shape, candidates.shape_distance),
    ):
        if kind[row] >= 0:
            far = f" {distance[row]:.1f}" if np.isfinite(distance[row]) else ""
            parts.append(names[kind[row]] + far)
    return ", ".join(parts)


def curve_of_terms(
    sequences: NDArray[np.complex128], terms: tuple[int, ...]
) -> NDArray[np.complex128]:
    """Outlines (n, samples) with these Fourier terms and their mean alone."""
    spectrum = np.fft.fft(sequences, axis=-1)
    kept = np.zeros_like(spectrum)
    rows = [0, *terms]
    kept[:, rows] = spectrum[:, rows]
    return np.asarray(np.fft.ifft(kept, axis=-1))


def outline_entities(item: Detections, *, detail: bool) -> list[Entity]:
    """Outlines as the shape classifier sees them (chapter 4) with their curves; with detail also of those refused."""
    candidates = item.candidates
    given = np.isfinite(candidates.shape_distance)
    rows = np.flatnonzero(given if detail else given & (candidates.verdict == 0))
    traced = outlines_of(item.segmentation, candidates.regions.select(rows)).points
    traced = traced[np.isfinite(traced).all(axis=1)] + 1j * item.segmentation.rows[0]
    found = []
    for name, ink in INKS.items():
        curves = traced if name == "traced" else curve_of_terms(traced, CURVES[name])
        ring = np.concatenate([curves, curves[:, :1]], axis=1)
        closed = np.stack([ring.real, ring.imag], axis=-1).astype(np.float32)
        found.append(Entity(f"{at.OUTLINES}/{name}", rr.LineStrips2D(closed, colors=[ink])))
    return found


def encoded(file: Any, media_type: str) -> rr.EncodedImage:
    """The bytes of an image file in Arrow's own memory: each that waits in the heap would part the holes of images."""
    held = pa.array([bytes(file)], pa.binary()).buffers()[2]
    inner = pa.Array.from_buffers(pa.uint8(), len(file), [None, held])
    blob: Any = pa.ListArray.from_arrays([0, len(file)], inner, type=BLOB)
    return rr.EncodedImage(contents=blob, media_type=media_type)


def panel_pictures(measurements: Sequence[Measurement]) -> dict[str, Any]:
    """The registered views of each measurement in a row, as they lie on its template, and the outlines on them.

    Archetypes by name; none where there are no views.
    """
    rows = [m for m in measurements if m.views]
    if not rows:
        return {}
    shapes = [m.views[0].rgb.shape[:2] for m in rows]
    wide = max((w + _GAP_PX) * len(m.views) for m, (_, w) in zip(rows, shapes, strict=True))
    picture = np.zeros((sum(h + _GAP_PX for h, _ in shapes), wide, 3), np.uint8)
    strips, words, top = [], [], 0
    for one, (height, width) in zip(rows, shapes, strict=True):
        sides = () if one.outline is None else one.outline
        for i, view in enumerate(one.views):
            left = i * (width + _GAP_PX)
            seen = warp_to_template(view.rgb, view.alignment)
            picture[top : top + height, left : left + width] = np.clip(np.rint(seen), 0, 255)
            strips += [side + np.array([left + 0.5, top + 0.5]) for side in sides]
            words += [
                f"track {one.track_id}, frame {view.frame}, {one.shape or 'no outline'}, "
                f"correlation {view.alignment.zncc:.3f}"
            ] * len(sides)
        top += height + _GAP_PX
    lines = rr.LineStrips2D(strips, colors=[GOOD], labels=words or None, show_labels=False)
    views: Any = rr.Image(picture).compress(jpeg_quality=_QUALITY)
    jpeg = encoded(views.blob.pa_array.values.to_numpy(), "image/jpeg")
    return {"views": jpeg, "outlines": lines}
