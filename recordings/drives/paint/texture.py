"""Textures: float32 RGBA in linear light with premultiplied alpha, row 0 at the top."""

from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from recordings.drives.arrays import Bytes, Singles

Rgb: TypeAlias = tuple[float, float, float]
"""An sRGB colour in 0..255."""

FractionalBox: TypeAlias = tuple[float, float, float, float]
"""Left, top, right, bottom as fractions of an image."""


def linear(red: float, green: float, blue: float) -> Singles:
    """Linear light of an sRGB colour given in 0..255, shape (3,)."""
    return (np.array([red, green, blue], np.float32) / 255.0) ** np.float32(2.2)


def ink(color: Singles) -> list[float]:
    """A colour (3,) as the opaque RGBA value that the drawing functions take."""
    return [*map(float, color), 1.0]


def rgba(color: Singles, alpha: Singles) -> Singles:
    """Premultiplied RGBA (rows, columns, 4)."""
    return np.dstack([color * alpha[..., None], alpha]).astype(np.float32)


def shrink(image: Singles | Bytes, columns: int, rows: int) -> Singles:
    """An image reduced by averaging areas, with the same range of values."""
    return np.asarray(cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)


class Texture:
    """RGBA texture with halved copies (`levels`, largest first) for minification."""

    def __init__(self, image: NDArray[np.floating]) -> None:
        self.levels: list[Singles] = [np.ascontiguousarray(image, np.float32)]
        while min(self.levels[-1].shape[:2]) >= 8:
            rows, columns = self.levels[-1].shape[:2]
            self.levels.append(shrink(self.levels[-1], (columns + 1) // 2, (rows + 1) // 2))

    def sized(self, columns: int, rows: int) -> Singles:
        """The texture reduced to about columns by rows texels (never enlarged)."""
        level = self.levels[0]
        for smaller in self.levels[1:]:
            if smaller.shape[0] < rows or smaller.shape[1] < columns:
                break
            level = smaller
        size = (min(columns, level.shape[1]), min(rows, level.shape[0]))
        return level if size == (level.shape[1], level.shape[0]) else shrink(level, *size)


def opaque(color: Singles) -> Texture:
    """Texture without holes."""
    return Texture(rgba(color, np.ones(color.shape[:2], np.float32)))


def sheet(color: Rgb, columns: int, rows: int) -> Singles:
    """Image (rows, columns, 3) of one colour."""
    image = np.empty((rows, columns, 3), np.float32)
    image[:] = linear(*color)
    return image


def fill_box(image: Singles, box: FractionalBox, color: Singles) -> None:
    """Fill a box of an image."""
    rows, columns = image.shape[:2]
    top, bottom = round(box[1] * rows), round(box[3] * rows)
    image[top:bottom, round(box[0] * columns) : round(box[2] * columns)] = color


def write_text(image: Singles, text: str, box: FractionalBox, color: Singles) -> None:
    """Write text that fills a box of a linear RGB image."""
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 3.0, 1)
    plate: Bytes = np.zeros((height + 30, width + 20), np.uint8)
    cv2.putText(plate, text, (10, height + 10), cv2.FONT_HERSHEY_SIMPLEX, 3.0, 255, 10, cv2.LINE_AA)
    rows, columns = image.shape[:2]
    x0, x1 = round(box[0] * columns), round(box[2] * columns)
    y0, y1 = round(box[1] * rows), round(box[3] * rows)
    if x1 - x0 < 4 or y1 - y0 < 4:
        return
    shrunk = cv2.resize(plate, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
    alpha = shrunk[..., None] / np.float32(255)
    image[y0:y1, x0:x1] = image[y0:y1, x0:x1] * (1 - alpha) + color * alpha
