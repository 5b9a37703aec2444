"""Learn where signs stand and the outlines of panels from rendered drives: `python -m training.learn`.

The networks (`network_training.py`), their thresholds (`box_thresholds.py`), the landmark classifiers, which decide on
what these let through (`learn_landmarks.py`), and the face classifier (`face_codes.py`) are learned by themselves.
The same drives, seed and package versions give the same files.

Of outlines: tracking is left out, poses are the true ones, and detected boxes are drawn about the true panel with the
scatter that detected boxes have. Views are rectified and registered as in a run. Of all candidates of a face the one
nearest to the true outline is right; the weights maximise the likelihood of this (conditional logit, McFadden 1974).
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from training.truth import (
    DRIVES,
    OUT,
    SEED,
    command,
    images,
    learning_logs,
    read_truth,
    sign_positions,
    write_model,
)
from wayside.pipeline.evaluation.rendered import camera_pose
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.learning.fits import side_classes
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.models.model_folder import shipped_models
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.frame import Image, Pose
from wayside.schemas.models import GaussianModel, LinearModel
from wayside.stages.panel import (
    OUTLINE_FEATURES,
    OUTLINE_SHAPES,
    PanelPlane,
    PosedImage,
    RegisteredViews,
    gradients_of,
    outline_candidates,
    register_views,
    usable_views,
)

LONGEST = 14
"""Images before the last one of a face that are used: those that tracking has at hand (`track.longest`)."""
VISIBLE = 0.9
"""Visible fraction of a face from which an image shows it."""
INNER_FIELD, SIZE_SIGMA, CENTRE_SIGMA = 1.06, 0.05, 0.02
"""Boxes follow the inner field of a face: the panel is larger by this factor; relative scatter of their size and centre
(measured, as in `schemas/settings/landmark.py`)."""
BOXES = 3
"""Detected boxes that are drawn for each face."""
NEAREST = 1.5
"""Samples by which a side of the right candidate may be off; faces without such a candidate are left out."""
RIDGE = 0.0005
"""Weight of the squared weights, each in standard deviations of its feature, for each face. On eight held-out drives
427 of 555 choices are right with this, 409 with 0.002, 397 with 0.005 (408 with the weights that ship)."""
FEWEST = 30
"""Faces below which nothing is learned."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OutlineChoice:
    """The candidates of a face: features (n, d), numbers of the right ones, and the drive."""

    features: Floats
    right: Sequence[int]
    drive: str


def gather_choices(
    images: Iterable[tuple[Image, NDArray[np.uint8]]],
    truth: dict[str, Any],
    model: LinearModel,
    seed: int,
) -> list[OutlineChoice]:
    """Candidates of the outlines of all faces of a drive, with the right one.

    Signs without a position, or of a shape without template, are left out. `model` is used only where boxes do not
    correlate. `seed` is of the scatter of the detected boxes.
    """
    rng = np.random.default_rng(seed)
    choices: list[OutlineChoice] = []
    for sign, views in faces_shown(images, truth):
        for _ in range(BOXES):
            choice = _choice(sign, views, model, rng, truth["name"])
            choices += [] if choice is None else [choice]
    return choices


def faces_shown(
    images: Iterable[tuple[Image, NDArray[np.uint8]]], truth: dict[str, Any]
) -> Iterator[tuple[dict[str, Any], list[PosedImage]]]:
    """The signs of a drive, each with the images that show it, where the last of these is reached."""
    signs = [s for s in truth["signs"] if "centre" in s and _shape(s) in OUTLINE_SHAPES]
    shown = {s["id"]: [v["frame"] for v in s["frames"] if _clear(v)] for s in signs}
    poses = {frame["index"]: Pose(*camera_pose(frame)) for frame in truth["frames"]}
    held: dict[int, PosedImage] = {}
    for image, rgb in images:
        index, camera = image.frame.index, image.frame.camera
        if camera is None or index not in poses:
            continue
        held[index] = PosedImage(index, poses[index], camera, rgb)
        held = {k: one for k, one in held.items() if k > index - LONGEST}
        for sign in signs:
            if shown[sign["id"]][-1:] == [index]:
                yield sign, [held[k] for k in shown[sign["id"]] if k in held]


def registered_face(
    sign: dict[str, Any],
    images: Sequence[PosedImage],
    model: LinearModel,
    rng: np.random.Generator,
) -> RegisteredViews | None:
    """The views of a sign, registered about a box drawn as detected ones scatter."""
    centre, size = np.array(sign["centre"]), np.array([sign["width_m"], sign["height_m"]])
    last = images[-1].pose
    plane = PanelPlane.across(centre, last.rotation[:, 2], -last.rotation[:, 1])
    detected = size / INNER_FIELD * np.exp(rng.normal(0, SIZE_SIGMA, 2))
    offset = rng.normal(0, CENTRE_SIGMA, (1, 2)) * size
    found_plane = plane._replace(point=plane.points(offset)[0])
    usable = usable_views(found_plane, detected, images)
    if not usable:
        return None
    frames = np.array([image.frame for image in images], np.int64)
    return register_views(found_plane, detected, usable, frames, model)


def _choice(
    sign: dict[str, Any],
    images: Sequence[PosedImage],
    model: LinearModel,
    rng: np.random.Generator,
    drive: str,
) -> OutlineChoice | None:
    registered = registered_face(sign, images, model, rng)
    if registered is None:
        return None
    up = -images[-1].pose.rotation[:, 1]
    panel = PanelPlane.across(np.array(sign["centre"]), -np.array(sign["normal"]), up)
    true = true_box(registered, panel, np.array([sign["width_m"], sign["height_m"]]))
    views = registered.stacked()
    found, features = outline_candidates(views, gradients_of(views), registered.box)
    off = np.array([np.abs(outline.box - true).max() for outline in found])
    off[[outline.shape != _shape(sign) for outline in found]] = np.inf
    if not len(found) or off.min() > NEAREST:
        return None
    return OutlineChoice(features, [int(off.argmin())], drive)


def true_box(registered: RegisteredViews, panel: PanelPlane, size: Floats) -> Floats:
    """Box (4,) of a panel of this plane and size (2,) in samples of the template."""
    template = registered.views[0][0]
    ends = np.array([[-1, 0], [0, -1], [1, 0], [0, 1]]) * size / 2
    met = registered.plane.meet(template.image.pose.centre, panel.points(ends)) / registered.step
    middle = (np.array(template.rgb.shape[1::-1]) - 1) / 2
    return np.array([met[0, 0], met[1, 1], met[2, 0], met[3, 1]]) + np.tile(middle, 2)


def learn_outlines(choices: Sequence[OutlineChoice], origin: str) -> LinearModel:
    """Fit the weights; the provenance says how many choices are right on drives that were held out.

    Raises InputError where there are too few faces.
    """
    if len(choices) < FEWEST:
        raise InputError(
            f"outlines: {FEWEST} faces with a known outline are needed, and there are {len(choices)}. Add drives."
        )
    drives = sorted({choice.drive for choice in choices})
    right = 0
    for drive in drives if len(drives) > 1 else ():
        weights = fitted([choice for choice in choices if choice.drive != drive])
        own = [choice for choice in choices if choice.drive == drive]
        right += sum(int(np.argmax(c.features @ weights)) in c.right for c in own)
    held_out = f", held out by drive right for {right}" if len(drives) > 1 else ""
    return LinearModel(
        OUTLINE_FEATURES,
        fitted(choices),
        f"conditional logit over the outlines of {len(choices)} faces{held_out}; {origin}",
    )


def fitted(choices: Sequence[OutlineChoice]) -> Floats:
    """Weights (d,) of largest likelihood, with a ridge."""
    table = np.concatenate([c.features for c in choices])
    scale = table.std(axis=0)
    scale[scale < 1e-9] = 1.0
    table, lengths = table / scale, np.array([len(c.features) for c in choices])
    starts, ridge = lengths.cumsum() - lengths, RIDGE * len(choices)
    right = np.concatenate([np.isin(np.arange(len(c.features)), c.right) for c in choices])

    def cost(weights: Floats) -> tuple[float, Floats]:
        value = table @ weights
        density = np.exp(value - np.maximum.reduceat(value, starts).repeat(lengths))
        all_, good = (np.add.reduceat(one, starts) for one in (density, density * right))
        pull = density * ((1 / all_).repeat(lengths) - right * (1 / good).repeat(lengths))
        loss = float(np.log(all_ / good).sum()) + ridge / 2 * float(weights @ weights)
        return loss, pull @ table + ridge * weights

    found = minimize(cost, np.zeros(len(scale)), jac=True, method="L-BFGS-B")
    return np.asarray(found.x / scale, np.float64)


def _shape(sign: dict[str, Any]) -> str:
    upward = sign["shape"] == "triangle" and sign["point_up"]
    return "triangle_up" if upward else str(sign["shape"])


def _clear(view: dict[str, Any]) -> bool:
    return bool(view["side"] == "front" and view["visible_fraction"] >= VISIBLE)


FEWEST_SIGNS = 4
"""A side of the road of fewer signs is not learned."""


def learn(drives: Path, out: Path, seed: int) -> None:
    """Learn `location.json` and `outline.json` and write them into `out`.

    Raises InputError if drives are missing, cannot be used, or show too few signs. Raises OutputError if a file cannot
    be written, or `out` is the folder of the models that ship.
    """
    if out.resolve() == Path(str(shipped_models())).resolve():
        raise OutputError(
            f"{out}: this is the folder of the models that ship, which are in use while others are learned. Choose "
            "another folder; `make learn` moves the new ones at its end."
        )
    logs = learning_logs(drives)
    truths = [read_truth(log) for log in logs]
    listed = ", ".join(
        f"{truth['name']} ({len(truth['frames'])} images, {len(truth['signs'])} signs)"
        for truth in truths
    )
    origin = f"rendered drives {listed}; seed {seed}; numpy {np.__version__}"
    places = np.concatenate([sign_positions(truth) for truth in truths])
    write_model(out / "location.json", location_model(places, origin))
    settings, _ = load_settings()
    # views are registered with the model that ships
    model = load_models(settings).outline_weights
    choices = [
        choice
        for log, truth in zip(logs, truths, strict=True)
        for choice in gather_choices(images(log), truth, model, seed)
    ]
    write_model(out / "outline.json", learn_outlines(choices, origin))


def location_model(places: NDArray[np.float64], provenance: str) -> GaussianModel:
    """Where signs stand, (right of the path, above the camera's path) in metres: the mixture of preset `default`.

    `places` (n, 2): of signs. Overhead panels hang 4 m above the camera or higher; the rest stands right or left. A
    component holds all of its own signs within 4 sigma, because the next sign may lie beyond the last one seen. Those
    of preset `report` are learned by `gates`.
    """
    classes = side_classes(places, 4.0, FEWEST_SIGNS)
    for i, one in enumerate(classes):
        if one.name == "overhead":
            # Over any lane: three lanes either way are as likely as the middle.
            middle, broad = np.array([0.0, one.mean[1]]), np.diag([5.0**2, one.covariance[1, 1]])
            classes[i] = replace(one, mean=middle, covariance=broad)
    return GaussianModel("right_up_m", tuple(classes), provenance)


main = command(__doc__, learn, drives=DRIVES, out=OUT, seed=SEED)

if __name__ == "__main__":
    sys.exit(main())
