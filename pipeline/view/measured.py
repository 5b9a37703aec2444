"""How landmarks were measured: registered views of their panels, residuals of the windowed adjustment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from wayside.pipeline.view import entities as at
from wayside.pipeline.view.entities import Entity
from wayside.pipeline.view.landmarks import THIN
from wayside.schemas.measurement import Measurement
from wayside.stages.panel import warp_to_template
from wayside.stages.segmentation import difference_image

GAP_PX, QUALITY = 4, 92
"""Between views in a picture of several."""
OUTLINE_INK, MOVED_INK = (90, 220, 120), (245, 150, 60)


@dataclass(frozen=True, slots=True)
class PanelPicture:
    """Registered views side by side; of each the outline (k, 2, 2) in pixels of the picture, and words."""

    image: rr.EncodedImage | rr.Image
    outlines: tuple[NDArray[np.float64], ...]
    words: tuple[str, ...]

    def entities(self, path: str, *, static: bool = False) -> tuple[Entity, ...]:
        """The picture and the outlines on it."""
        strips = [end for one in self.outlines for end in one]
        words = [w for one, w in zip(self.outlines, self.words, strict=True) for _ in one]
        lines = rr.LineStrips2D(
            strips, colors=[OUTLINE_INK], labels=words or None, show_labels=False
        )
        return (
            Entity(f"{path}/views", (self.image,), static),
            Entity(f"{path}/outlines", (lines,), static),
        )


@dataclass(frozen=True, slots=True)
class SignMeasurement:
    """What is kept of the measurement of a sign until its number is known."""

    picture: PanelPicture | None
    history_sigmas: tuple[float, ...]

    @classmethod
    def of(cls, measured: Measurement) -> SignMeasurement:
        """The registered views compressed, and the residuals of the windowed adjustment."""
        adjusted = measured.adjustment
        return cls(panel_picture([measured]), () if adjusted is None else adjusted.history_sigmas)

    def entities(self, part: str) -> Iterator[Entity]:
        """Of the sign with this part of a path."""
        if self.picture is not None:
            yield from self.picture.entities(f"{at.SIGN_PANELS}/{part}", static=True)
        if self.history_sigmas:
            bars = rr.BarChart(np.array(self.history_sigmas))
            yield Entity(f"{at.SIGN_ITERATIONS}/{part}", (bars,), static=True)


def panel_picture(measurements: Sequence[Measurement]) -> PanelPicture | None:
    """The registered views of each measurement in a row, as they lie on its template; None where there are none."""
    rows = [m for m in measurements if m.views]
    if not rows:
        return None
    shapes = [m.views[0].rgb.shape[:2] for m in rows]
    wide = max((w + GAP_PX) * len(m.views) for m, (_, w) in zip(rows, shapes, strict=True))
    picture = np.zeros((sum(h + GAP_PX for h, _ in shapes), wide, 3), np.uint8)
    outlines, words, top = [], [], 0
    for one, (height, width) in zip(rows, shapes, strict=True):
        for i, view in enumerate(one.views):
            left = i * (width + GAP_PX)
            seen = warp_to_template(view.rgb, view.alignment)
            picture[top : top + height, left : left + width] = np.clip(np.rint(seen), 0, 255)
            segments = np.zeros((0, 2, 2)) if one.outline is None else one.outline
            outlines.append(segments + np.array([left + 0.5, top + 0.5]))
            words.append(
                f"track {one.track_id}, frame {view.frame}, {one.shape or 'no outline'}, "
                f"correlation {view.alignment.zncc:.3f}"
            )
        top += height + GAP_PX
    image = rr.Image(picture).compress(jpeg_quality=QUALITY)
    return PanelPicture(image, tuple(outlines), tuple(words))


def measurement_entities(measurements: Sequence[Measurement]) -> list[Entity]:
    """What the measurements of one frame's landmarks show; there must be some."""
    picture = panel_picture(measurements)
    found = [] if picture is None else [*picture.entities(at.PANELS)]
    adjusted = [m.adjustment for m in measurements if m.adjustment is not None]
    if adjusted:
        squares = [(a.history_sigmas[0] ** 2, a.history_sigmas[-1] ** 2) for a in adjusted]
        before, after = np.sqrt(np.mean(squares, axis=0))
        found += [
            Entity(f"{at.WINDOW_RESIDUALS}/before", (rr.Scalars([before]),)),
            Entity(f"{at.WINDOW_RESIDUALS}/after", (rr.Scalars([after]),)),
            Entity(
                at.MOVED,
                (
                    rr.LineStrips3D(
                        [np.stack([a.start, a.position]) for a in adjusted],
                        colors=[MOVED_INK],
                        labels=[adjustment_words(m) for m in measurements if m.adjustment],
                        show_labels=False,
                        radii=THIN,
                    ),
                ),
            ),
        ]
    return found


def adjustment_words(measurement: Measurement) -> str:
    """Residuals of the windowed adjustment and how far it moved the landmark, in words."""
    a = measurement.adjustment
    if a is None:
        return f"track {measurement.track_id}: not adjusted"
    moved = float(np.linalg.norm(a.position - a.start))
    return (
        f"track {measurement.track_id}: residual {a.history_sigmas[0]:.2f} to {a.history_sigmas[-1]:.2f} sigmas in "
        f"{len(a.history_sigmas) - 1} iterations over frames {a.first_frame} to {a.last_frame}, moved {moved:.2f} m"
    )


def difference_entity(
    rgb: NDArray[np.uint8],
    palette: NDArray[np.float32],
    rows: tuple[int, int],
) -> Entity:
    """The difference image (report chapter 2.3) of the segmented rows, 255 at most; black elsewhere."""
    full = np.zeros(rgb.shape[:2], np.uint8)
    differences = difference_image(rgb[rows[0] : rows[1]], np.rint(palette))
    full[rows[0] : rows[1]] = np.minimum(differences, 255)
    good, coded = cv2.imencode(".jpg", full, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    image = rr.EncodedImage(contents=coded.tobytes(), media_type="image/jpeg", opacity=0.9)
    return Entity(at.DIFFERENCE, (image,) if good else (rr.Clear(recursive=False),))
