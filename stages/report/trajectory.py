"""Trajectory of a tracked feature in the image, held against the typical motion of signs (report chapter 5)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import InputError
from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.models import MixtureModel
from wayside.stages.classifiers import log_ratio
from wayside.stages.geometry import rotation_from_vector, vector_from_rotation

TRAJECTORY_FORMS = ("image", "compensated")
"""Order of the second axis of a trajectory, and spaces of its models."""
STEP_M = 8.04672
"""Displacements are those of a step of 26.4 ft, as between two images of the report."""


def trajectory_of(rays: NDArray[np.float64], poses: Sequence[Pose]) -> NDArray[np.float64]:
    """The trajectory (n - 1, 2, 4) of a feature: (u, v, du, dv) of each step between its views, in both forms.

    `rays` (n, 2): the feature in each view, oldest first; `poses`: camera of each. Values are nan where a ray lies
    behind the camera.

    Coordinates are x/z (right) and y/z (down), so one model serves all cameras; du, dv are scaled to a step of 26.4 ft.
    Form "image" takes them as they are, as in the report. In "compensated" both views are turned into the axes half way
    through the camera's rotation, in which a sign next to an arc moves as on a straight road.
    """
    steps = np.empty((max(len(rays) - 1, 0), len(TRAJECTORY_FORMS), 4))
    for k, (before, after) in enumerate(pairwise(poses)):
        length = float(np.linalg.norm(after.centre - before.centre))
        half = rotation_from_vector(vector_from_rotation(before.rotation.T @ after.rotation) / 2)
        turned = (_turned(rays[k], half.T), _turned(rays[k + 1], half))
        for form, (first, second) in enumerate(((rays[k], rays[k + 1]), turned)):
            flow = (second - first) * (STEP_M / length if length > 0 else np.nan)
            steps[k, form] = (*first, *flow)
    return steps


def _turned(ray: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """A ray (2,) as (x/z, y/z) in the turned axes."""
    x, y, z = rotation @ np.array([*ray, 1.0])
    return np.array([x, y]) / z if z > 0 else np.full(2, np.nan)


def mean_log_ratio(trajectory: NDArray[np.float64], model: MixtureModel) -> float:
    """Mean over the steps of a trajectory (s, 2, 4) of the log ratio in the form of the model; -inf without steps."""
    steps = trajectory[:, TRAJECTORY_FORMS.index(model.space)]
    known = steps[np.isfinite(steps).all(axis=1)]
    return float(log_ratio(known, model).mean()) if len(known) else -np.inf


def track_log_ratio(one: Landmark, model: MixtureModel) -> float:
    """`mean_log_ratio` of the trajectory of a landmark."""
    return mean_log_ratio(trajectory_of(*one.trace), model)


def classify_trajectory(
    tracked: Iterator[TrackedFrame], model: MixtureModel
) -> Iterator[TrackedFrame]:
    """Refuse what does not move in the image as signs do (`trajectory`).

    The report holds each (u, v, du, dv) against a density of signs. Here it is held against that of other tracks as
    well (likelihood ratio, chapter 9); a track is as typical as its steps are on average. Raises InputError where the
    model is of a space that is not among `TRAJECTORY_FORMS`.
    """
    if model.space not in TRAJECTORY_FORMS or model.mean.shape[1] != 4:
        raise InputError(
            f"trajectory model: it has {model.mean.shape[1]} numbers in {model.space!r} instead of 4 in a space among "
            f"{', '.join(TRAJECTORY_FORMS)}. Learn it again."
        )
    for frame in tracked:
        landmarks = (
            replace(one, verdict="trajectory")
            if one.verdict == "sign" and not track_log_ratio(one, model) >= model.threshold
            else one
            for one in frame.landmarks
        )
        yield replace(frame, landmarks=tuple(landmarks))
