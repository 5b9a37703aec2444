"""The stage that classifies the faces of landmarks by their pixels."""

from array import array
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.measurement import Measurement
from wayside.stages.classifiers import OnnxNetwork

PATCH_SIDE, PATCH_MARGIN = 32, 0.08
"""Samples of a patch each way; what it shows around the face, as a fraction of its sides. Part of the input format."""

OTHER_FACE = "other"
"""Class of the face classifier for all faces without one of its codes."""

_DARK_LEVEL, _FLAT = 16.0, 0.1
"""Added to a grey value before its logarithm, and to the scatter of the logarithms: noise of dark pixels or of a face
without contrast is no legend. Part of the input format."""
FACE_VIEWS = 5
"""Nearest registered views whose face is classified: farther ones are coarser."""
BLACK = 0.42
"""Largest brightest channel of a black ground over that of the legend. Real lane-use signs have 0.24 to 0.38, blue
grounds 0.56 or more, rendered signs of several colours 0.44 and 0.46. Black signs are rare: it is near theirs."""
INNER = slice(5, -5)
"""Part of a patch, without the surroundings of the face and its border."""
LEAST_LOG_PROBABILITY = -7.0
"""Least log probability of a class of face in one view: one bad view must not rule a class out."""
FACES, FACE_OUTPUT, CLASSES = "faces", "scores", "classes"
"""Names of the input and of the output of a network, and of its metadata that lists the classes, in lines."""


class FaceClassifier:
    """A network that decides which of its `classes` a face is, from an ONNX file. Raises ValueError for other files."""

    def __init__(self, path: str) -> None:
        self._network = OnnxNetwork(path, (FACE_OUTPUT,))
        self.classes = tuple(self._network.metadata.get(CLASSES, "").split("\n"))
        found = self.log_probabilities(np.zeros((1, PATCH_SIDE, PATCH_SIDE, 3), np.uint8)).shape
        if found != (1, len(self.classes)):
            raise ValueError(
                f"scores of shape {found[1:]} instead of one for each of {len(self.classes)} classes"
            )

    def log_probabilities(self, patches: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Log probability (n, classes) of each class for patches (n, 32, 32, 3)."""
        scores = self._network.run({FACES: face_samples(patches)})[FACE_OUTPUT]
        return np.asarray(log_softmax(scores.astype(np.float64), axis=1))


def classify_faces(
    frames: Iterator[TrackedFrame], *, model: FaceClassifier
) -> Iterator[TrackedFrame]:
    """Give every landmark whose face was measured the log probability of each class of the classifier.

    Panels seen from behind have no face.
    """
    for frame in frames:
        measured = {one.track_id: one for one in frame.measurements}
        landmarks = tuple(
            _classified(landmark, measured.get(landmark.track_id), model)
            for landmark in frame.landmarks
        )
        yield replace(frame, landmarks=landmarks)


def _classified(
    landmark: Landmark, measured: Measurement | None, model: FaceClassifier
) -> Landmark:
    """The mean over the views of the log probability of each class; views of one face err together."""
    if landmark.back or measured is None or measured.face is None:
        return landmark
    patches = np.stack(_face_patches(measured, measured.face))
    mean = np.maximum(model.log_probabilities(patches), LEAST_LOG_PROBABILITY).mean(axis=0)
    landmark = replace(landmark, face_log_probability=array("d", mean - np.logaddexp.reduce(mean)))
    if landmark.color == "blue" and is_black(patches):  # the networks know no black
        return replace(landmark, color="black", color_log_probability=())
    return landmark


def is_black(patches: NDArray[np.uint8]) -> bool:
    """Whether faces (n, 32, 32, 3) with a bright legend have a ground too dark for any colour but green and brown."""
    inner = patches[:, INNER, INNER].reshape(len(patches), -1, 3).astype(np.float64)
    darker = np.sort(inner, axis=1)[:, : inner.shape[1] // 2]
    legend = np.maximum(np.percentile(inner, 95, axis=1), 1.0)
    ground = (np.median(darker, axis=1) / legend).max(axis=1)
    return bool(np.median(ground) < BLACK)


def _face_patches(measured: Measurement, face: NDArray[np.float64]) -> list[NDArray[np.uint8]]:
    """The face, a box (4,) in samples of the template, in the nearest registered views."""
    box = face.reshape(2, 2)
    patches = []
    for view in measured.views[:FACE_VIEWS]:
        middle = (np.array(view.rgb.shape[1::-1]) - 1) / 2
        lies = view.alignment
        there = middle + lies.shift + lies.stretch * (box - middle)
        # pixel centres are at integers: the box ends half a sample beyond them
        patches.append(face_patch(view.rgb, np.concatenate([there[0] + 0.5, there[1] + 0.5])))
    return patches


def face_patch(rgb: NDArray[np.uint8], box: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The face in a box [x0, y0, x1, y1] of an image (h, w, 3) with its margin, resampled: (32, 32, 3).

    What lies beyond the image is its edge repeated; a box without area is one pixel.
    """
    size = np.maximum(box[2:] - box[:2], 1.0)
    low = np.floor(box[:2] - PATCH_MARGIN * size).astype(int)
    high = np.maximum(np.ceil(box[2:] + PATCH_MARGIN * size).astype(int), low + 1)
    part = cv2.getRectSubPix(rgb, (high - low).tolist(), ((low + high - 1) / 2).tolist())
    shrinks = min(part.shape[:2]) > PATCH_SIDE
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(part, (PATCH_SIDE, PATCH_SIDE), interpolation=how), np.uint8)


def face_samples(patches: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Patches (n, 32, 32, 3) as samples (n, 3, 32, 32): brightness of mean 0 and scatter 1, log R/G, log B/G."""
    planes = np.ascontiguousarray(np.moveaxis(patches, -1, 1), np.float32)
    logarithm = np.log(planes + np.float32(_DARK_LEVEL))
    bright = logarithm.mean(axis=1)
    middle = bright.mean(axis=(1, 2), keepdims=True)
    scatter = bright.std(axis=(1, 2), keepdims=True)
    bright = (bright - middle) / (scatter + np.float32(_FLAT))
    red, green, blue = (logarithm[:, k] for k in range(3))
    return np.stack([bright, red - green, blue - green], axis=1)
