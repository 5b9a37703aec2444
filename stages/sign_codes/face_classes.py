"""The stage that classifies the faces of landmarks by their pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.measurement import Measurement
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.sign_codes.face_patches import PATCH_SIDE, face_patch, face_samples

FACE_VIEWS = 5
"""Nearest registered views whose face is classified: farther ones are coarser."""
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

    Parameters
    ----------
    frames
        Frames with their landmarks and what those were measured by; panels seen from behind have no face.
    model
        The face classifier.

    Yields
    ------
    The frames, in order.
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
    patches = np.stack(_face_patches(measured, measured.face)[:FACE_VIEWS])
    each = np.maximum(model.log_probabilities(patches), LEAST_LOG_PROBABILITY)
    mean = each.mean(axis=0)
    return replace(
        landmark, face_log_probability=tuple((mean - np.logaddexp.reduce(mean)).tolist())
    )


def _face_patches(measured: Measurement, face: NDArray[np.float64]) -> list[NDArray[np.uint8]]:
    """The face, a box (4,) in samples of the template, in each registered view, the template first."""
    box = face.reshape(2, 2)
    patches = []
    for view in measured.views:
        middle = (np.array(view.rgb.shape[1::-1]) - 1) / 2
        lies = view.alignment
        there = middle + lies.shift + lies.stretch * (box - middle)
        # pixel centres are at integers: the box ends half a sample beyond them
        patches.append(face_patch(view.rgb, np.concatenate([there[0] + 0.5, there[1] + 0.5])))
    return patches
