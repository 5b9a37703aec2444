"""Candidates for sign faces: boxes of the detection network."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SHAPES, SOURCES, Dropped, NetworkBoxes, Regions, Segmentation
from wayside.schemas.frame import Camera, Image
from wayside.stages.detection.network_proposals import MULTIPLE, DetectionNetwork, boxes_of_maps
from wayside.stages.geometry import non_maximum_suppression
from wayside.stages.imaging import enlarged, halved
from wayside.stages.segmentation import FACE_ROWS, unsegmented

NARROWEST, WIDEST = 0.2, 6.5
"""Width over height of a face (chosen by hand)."""
SHORTEST_PX = 8
"""Height of the smallest face searched for, in images of `SHORTEST_FOCAL_PX` and more, px (chosen by hand)."""
SHORTEST_FOCAL_PX = 500.0
"""Images of a shorter focal length are seen twice as large, of half of it four times: at half size, 360 to 450 px, four
real drives gain 7 of 48 signs by it; at three quarters 1, and false rows."""
FILLED = {"rectangle": 0.98, "diamond": 0.5, "octagon": 0.83, "triangle": 0.5, "circle": 0.785}
"""Area of a shape as a fraction of its box."""
OTHER_FILLED = 0.8
"""The same of a shape that is not known: between a circle and a rectangle."""
SAME_REGION_IOU = 0.7
"""Boxes that overlap more are one candidate: at 0.45 faces were lost to their neighbours, at 0.6 not."""
FULL_SIZE_PX = (-640, -176, 640, 112)
"""What the network sees at full size: left, top, right, bottom about the optical axis. A face of half a metre that is
too small at half size has 32 px a metre at most, so it is seen up to 5.5 m above, 3.5 m below and 20 m beside it."""
HALF_SIZE = (-np.inf, FACE_ROWS[0], np.inf, FACE_ROWS[1])
"""The same at half size, as tangents."""
LEAST_SCORE = -2.0
"""Boxes of the network of lower log odds are left out: on seven drives less than 1 % of them were views of a sign. From
-1.5, two of 78 signs of real drives are lost."""
MOST_BOXES = 48
"""Boxes of the network that are kept in an image, at most: 60 find no more signs, and 40 one of 61 less in a city."""
SAME_BOX_IOU = 0.5
"""Of the network's boxes, those that overlap a better one more are suppressed (chosen by hand)."""


def propose(images: Iterator[Image], *, network: DetectionNetwork) -> Iterator[Segmentation]:
    """Take the boxes of a detection network as the regions of each image.

    The network sees the rows in which faces can be (`network_bands`). Boxes that no face has the size of are dropped,
    and of nearly the same boxes one stays; what is dropped is counted. An image that is not used has no regions.
    """
    for image in images:
        item, camera = unsegmented(image), image.frame.camera
        if image.rgb is None or camera is None:
            yield item
            continue
        bands = network_bands(network, image.rgb, camera)
        found = boxes_of_bands(bands, image.rgb.shape)
        item = replace(
            item,
            regions=regions_of(found.box, found.shape.argmax(axis=1), image.rgb, "network"),
            dropped=Dropped(left_out=found.left_out),
            network_score=found.front,
        )
        yield fitting(item, camera)


def fitting(item: Segmentation, camera: Camera) -> Segmentation:
    """The image with the regions that a face can be, by size and aspect, and one of those that are nearly the same."""
    box, score = item.regions.box, item.network_score
    rows = np.flatnonzero(fits_face(box, camera))
    kept = rows[non_maximum_suppression(box[rows], SAME_REGION_IOU)]
    return replace(
        item,
        regions=item.regions.select(kept),
        dropped=item.dropped.plus(Dropped(len(box) - len(rows), len(rows) - len(kept))),
        network_score=None if score is None else score[kept],
    )


@dataclass(frozen=True, slots=True)
class Band:
    """Part of an image from `corner` (x, y) on as the network sees it, a pixel `scale` pixels of the image: 1/4 to 2.

    `boxes`: by the network, pixels of the band; `size`: height and width of its input.
    """

    boxes: NetworkBoxes
    size: tuple[int, int]
    corner: tuple[int, int]
    scale: float

    def in_image(self) -> NDArray[np.float32]:
        """Its boxes (n, 4) in pixels of the image."""
        return self.boxes.box * np.float32(self.scale) + np.array(self.corner * 2, np.float32)

    def whole(self, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Which of its boxes (n,) end inside it, or where the image (height, width) does: the rest is cut."""
        box, size, corner = self.boxes.box, np.array(self.size[::-1]), np.array(self.corner)
        inside = corner + (size + 1) * self.scale <= shape[1::-1]
        cut = ((box[:, :2] <= 0) & (corner > 0)) | ((box[:, 2:] >= size) & inside)
        return np.asarray(~cut.any(axis=1))


def network_bands(network: DetectionNetwork, rgb: NDArray[np.uint8], camera: Camera) -> list[Band]:
    """What the network sees of an image: far faces near the horizon at full size, all rows with faces at half size.

    For an image of short focal length, full size is twice its own size, and half size is its own. A face is then as
    large as in the images that the network has learned from. Rows are a multiple of 32 where the image has them.
    """
    times = enlargement(camera)
    axis = np.array([camera.cx, camera.cy] * 2)
    far, near = np.array(FULL_SIZE_PX) / times, np.array(HALF_SIZE) * camera.fy
    found = []
    for scale, sides in ((1 / times, axis + far), (2 / times, axis + near)):
        pixels = (
            2 if scale > 1 else 1
        )  # of the image, each way, in one that is seen before it is enlarged
        left, top, right, bottom = np.rint(sides / pixels).clip(0, 1 << 30).astype(int)
        larger = round(pixels / scale)
        rows = MULTIPLE * round((bottom - top) * larger / MULTIPLE) // larger
        seen = rgb[pixels * top : pixels * (top + rows), pixels * left : pixels * right]
        seen = halved(seen) if pixels == 2 else seen
        if seen.size:
            band = enlarged(seen, larger)
            size, maps = band.shape[:2], network.maps(band)
            boxes = boxes_of_maps(maps, size, LEAST_SCORE, MOST_BOXES, SAME_BOX_IOU)
            found.append(Band(boxes, size, (left * pixels, top * pixels), scale))
    return found


def boxes_of_bands(bands: Sequence[Band], size: tuple[int, ...]) -> NetworkBoxes:
    """The best boxes of all bands in pixels of the image (height, width).

    Of a face that a border of the full-size band cuts, the box at half size stays.
    """
    if not bands:
        return NetworkBoxes.none()
    box = np.concatenate([band.in_image() for band in bands])
    whole = np.concatenate([band.whole(size) for band in bands])
    score, front, color, shape = (
        np.concatenate([getattr(band.boxes, name) for band in bands])
        for name in ("score", "front", "color", "shape")
    )
    order = np.argsort(-score, kind="stable")
    order = order[whole[order]]
    apart = order[non_maximum_suppression(box[order], SAME_BOX_IOU)]
    best = apart[:MOST_BOXES]
    left_out = len(apart) - len(best) + sum(band.boxes.left_out for band in bands)
    return NetworkBoxes(box[best], score[best], front[best], color[best], shape[best], left_out)


def regions_of(
    box: NDArray[np.float32], shape: NDArray[np.integer], rgb: NDArray[np.uint8], source: str
) -> Regions:
    """Boxes (n, 4) of faces of these shapes (n,) as regions of an image; the area of an unknown shape (-1) is usual."""
    filled = [OTHER_FILLED if k < 0 else FILLED.get(SHAPES[k], OTHER_FILLED) for k in shape]
    area = np.array(filled) * np.prod(box[:, 2:] - box[:, :2], axis=1)
    number = np.full(len(box), SOURCES.index(source), np.uint8)
    return Regions(box, area.astype(np.int32), mean_colors(rgb, box), number)


def enlargement(camera: Camera) -> int:
    """How many times as large the images of a camera are seen: 1 for most, 2, or 4 at most."""
    return next((k for k in (1, 2) if k * camera.fy >= SHORTEST_FOCAL_PX), 4)


def fits_face(box: NDArray[np.floating[Any]], camera: Camera) -> NDArray[np.bool_]:
    """Which boxes (n, 4) in images of a camera have the height and the aspect of a face."""
    wide, tall = box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]
    aspect = (wide >= NARROWEST * tall) & (wide <= WIDEST * tall)
    return np.asarray(aspect & (enlargement(camera) * tall >= SHORTEST_PX))


def mean_colors(rgb: NDArray[np.uint8], box: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean colour (n, 3) of the inner half of each box (n, 4): most of its corners show the background."""
    quarter = (box[:, 2:] - box[:, :2]) / 4
    low = np.floor(box[:, :2] + quarter).astype(int)
    high = np.maximum(np.ceil(box[:, 2:] - quarter).astype(int), low + 1)
    inner = np.concatenate([low, high], 1).tolist()
    means = [cv2.mean(rgb[y0:y1, x0:x1])[:3] for x0, y0, x1, y1 in inner]
    return np.array(means, np.float32).reshape(-1, 3)
