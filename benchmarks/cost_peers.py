"""Alternatives to wayside on the images of a log, one thread; in a process of its own, to measure its cost.

    python benchmarks/cost_peers.py LOG yolo|plain FRAMES

yolo: YOLO11 of the nano size by ultralytics at the input width of the images, with its tracker. Its weights are not
trained, which costs the same. plain: the method of KS-09-9 in the calls that OpenCV has for it, without tracking.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.settings import ReadSettings

CLUSTERS = 16
"""Of both passes of K-means."""
ROUNDS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 1.0)
SIZES = 50, 20_000
"""Areas of segments that pass the size gate, px."""


def main() -> None:
    """Process the first images."""
    log, way, count = sys.argv[1:]
    cv2.setNumThreads(1)
    WAYS[way](images(Path(log), int(count)))


def images(log: Path, count: int) -> Iterator[NDArray[np.uint8]]:
    """The first images of a log, decoded, blue first."""
    frames = read_frames(log, ReadSettings(spacing_m=8.0, thin_m=0.0), ReadReport())
    for _, frame in zip(range(count), frames, strict=False):
        yield np.asarray(cv2.imdecode(np.frombuffer(frame.data, np.uint8), 1), np.uint8)


def yolo(pictures: Iterator[NDArray[np.uint8]]) -> None:
    """Detect and track."""
    import torch
    from ultralytics import YOLO

    torch.set_num_threads(1)
    model = YOLO("yolo11n.yaml")
    for picture in pictures:
        model.track(picture, imgsz=picture.shape[1], persist=True, verbose=False, device="cpu")


def plain(pictures: Iterator[NDArray[np.uint8]]) -> None:
    """Two passes of K-means, segments of both, size gate, mean colours, SIFT of the whole image, matches."""
    sift, matcher, before = cv2.SIFT.create(), cv2.BFMatcher(), None
    for picture in pictures:
        pixels = picture.reshape(-1, 3).astype(np.float32)
        labels, centres = clusters(pixels)
        difference = np.linalg.norm(pixels - centres[labels], axis=1).astype(np.float32)
        for each in (labels, clusters(difference[:, None])[0]):
            segments(each.reshape(picture.shape[:2]), picture)
        _, found = sift.detectAndCompute(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), None)
        if before is not None:
            matcher.knnMatch(before, found, 2)
        before = found


def clusters(values: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Labels (n,) and centres of K-means."""
    _, labels, centres = cv2.kmeans(values, CLUSTERS, None, ROUNDS, 1, cv2.KMEANS_PP_CENTERS)
    return labels[:, 0], centres


def segments(labels: NDArray[np.int32], picture: NDArray[np.uint8]) -> list[NDArray[np.float64]]:
    """Mean colours (n, 3) of the connected segments of each label that pass the size gate."""
    found = []
    for label in range(CLUSTERS):
        mask = (labels == label).astype(np.uint8)
        _, parts, stats, _ = cv2.connectedComponentsWithStats(mask)
        area = stats[:, cv2.CC_STAT_AREA]
        sums = [np.bincount(parts.ravel(), picture[..., k].ravel()) for k in range(3)]
        kept = (area >= SIZES[0]) & (area <= SIZES[1])
        found.append((np.stack(sums, 1) / area[:, None])[kept])
    return found


WAYS: dict[str, Callable[[Iterator[NDArray[np.uint8]]], None]] = {"yolo": yolo, "plain": plain}

if __name__ == "__main__":
    main()
