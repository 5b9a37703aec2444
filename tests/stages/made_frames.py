"""Changes to made-up frames, and what tracking made of them."""

from dataclasses import replace

import cv2
import numpy as np

from wayside.schemas.detections import VERDICTS, Regions
from wayside.schemas.frame import USED, Frame, Image

FINER = 16


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
