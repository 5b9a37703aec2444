"""Candidates for sign faces: boxes of the detection network."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SHAPES, SOURCES, Dropped, NetworkBoxes, Regions, Segmentation
from wayside.schemas.frame import Camera, Image
from wayside.stages.detection.network_proposals import (
    MULTIPLE,
    DetectionNetwork,
    Part,
    boxes_of_maps,
)
from wayside.stages.imaging import enlarged, halved
from wayside.stages.kernels import Bytes, Flags, Floats, compiled, require_array, require_image
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
FULL_SIZE_PX = (-640, -176, 640, 112)
"""What the network sees at full size: left, top, right, bottom about the optical axis. A face of half a metre that is
too small at half size has 32 px a metre at most, so it is seen up to 5.5 m above, 3.5 m below and 20 m beside it."""
HALF_SIZE = (-np.inf, FACE_ROWS[0], np.inf, FACE_ROWS[1])
"""The same at half size, as tangents: with 0.1 below, a low beacon of a hilly drive is lost."""
LEAST_SCORE = -2.0
"""Boxes of the network of lower log odds are left out: on four rendered and three real drives of development less than
1 % of them were views of a sign. Kept also because -1.75 loses one of 272 signs of the held-out drives."""
MOST_BOXES = 48
"""Boxes of the network that are kept in an image, at most: 60 find no more, 40 lose one of 61 on ca_city_garmin."""
SAME_BOX_IOU = 0.5
"""Of the network's boxes, those that overlap a better one more are suppressed (chosen by hand)."""


def propose(images: Iterator[Image], *, network: DetectionNetwork) -> Iterator[Segmentation]:
    """Take the boxes of a detection network as the regions of each image.

    The network sees the rows in which faces can be (`network_boxes`). Boxes that no face has the size of are dropped
    and counted. An image that is not used has no regions.
    """
    for image in images:
        item, camera = unsegmented(image), image.frame.camera
        if image.rgb is None or camera is None:
            yield item
            continue
        found = network_boxes(network, image.rgb, camera)
        fits = found.select(fits_face(found.box, camera))
        yield replace(
            item,
            regions=regions_of(fits.box, fits.shape, image.rgb, "network"),
            dropped=Dropped(size=len(found) - len(fits), left_out=found.left_out),
            network_score=fits.front,
        )


def network_boxes(network: DetectionNetwork, rgb: Bytes, camera: Camera) -> NetworkBoxes:
    """The best boxes of an image: far faces near the horizon at full size, all rows with faces at half size.

    For an image of short focal length, full size is twice its own size, and half size is its own. A face is then as
    large as in the images that the network has learned from. Rows are a multiple of 32 where the image has them.
    """
    times = enlargement(camera)
    axis = np.array([camera.cx, camera.cy] * 2)
    far, near = np.array(FULL_SIZE_PX) / times, np.array(HALF_SIZE) * camera.fy
    parts = []
    for scale, sides in ((1 / times, axis + far), (2 / times, axis + near)):
        pixels = 2 if scale > 1 else 1  # of the image, each way, in one before it is enlarged
        left, top, right, bottom = np.rint(sides / pixels).clip(0, 1 << 30).astype(int).tolist()
        larger = round(pixels / scale)
        rows = MULTIPLE * round((bottom - top) * larger / MULTIPLE) // larger
        seen = rgb[pixels * top : pixels * (top + rows), pixels * left : pixels * right]
        seen = halved(seen) if pixels == 2 else seen
        if seen.size:
            band = enlarged(seen, larger)
            corner = left * pixels, top * pixels
            parts.append(Part(network.maps(band), band.shape[:2], corner, scale))
    return boxes_of_maps(parts, rgb.shape, LEAST_SCORE, MOST_BOXES, SAME_BOX_IOU)


def regions_of(box: Floats, shape: NDArray[np.integer], rgb: Bytes, source: str) -> Regions:
    """Boxes (n, 4) of faces of these shapes (n,) as regions of an image; the area of an unknown shape (-1) is usual."""
    filled = [OTHER_FILLED if k < 0 else FILLED.get(SHAPES[k], OTHER_FILLED) for k in shape]
    area = np.array(filled) * np.prod(box[:, 2:] - box[:, :2], axis=1)
    number = np.full(len(box), SOURCES.index(source), np.uint8)
    return Regions(box, area.astype(np.int32), mean_colors(rgb, box), number)


def enlargement(camera: Camera) -> int:
    """How many times as large the images of a camera are seen: 1 for most, 2, or 4 at most."""
    return next((k for k in (1, 2) if k * camera.fy >= SHORTEST_FOCAL_PX), 4)


def fits_face(box: NDArray[np.floating[Any]], camera: Camera) -> Flags:
    """Which boxes (n, 4) in images of a camera have the height and the aspect of a face."""
    wide, tall = box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]
    aspect = (wide >= NARROWEST * tall) & (wide <= WIDEST * tall)
    return np.asarray(aspect & (enlargement(camera) * tall >= SHORTEST_PX))


def mean_colors(rgb: Bytes, box: Floats) -> Floats:
    """Mean colour (n, 3) of the inner half of each box (n, 4): most of its corners show the background."""
    require_image(rgb)
    require_array(box, "box", np.float32, (None, 4))
    mean = np.empty((len(box), 3), np.float32)
    _mean_colors(rgb, box, mean)
    return mean


@compiled
def _mean_colors(rgb: Any, box: Any, mean: Any) -> None:
    for n in range(len(box)):
        quarter = (box[n, 2:] - box[n, :2]) / np.float32(4)
        left, top = np.floor(box[n, :2] + quarter)
        right, bottom = np.ceil(box[n, 2:] - quarter)
        columns = range(max(int(left), 0), min(int(max(right, left + 1)), rgb.shape[1]))
        rows = range(max(int(top), 0), min(int(max(bottom, top + 1)), rgb.shape[0]))
        total = np.zeros(3, np.int64)
        for i in rows:
            for j in columns:
                for k in range(3):
                    total[k] += rgb[i, j, k]
        mean[n] = total / max(len(rows) * len(columns), 1)
