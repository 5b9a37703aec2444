"""Thresholds of the report's gates, and where signs stand, from what the gates are asked about on labelled drives.

    .venv/bin/python -m wayside.pipeline.learning.gates DRIVE.mcap ... -o MODELS

Each drive needs its truth in the same folder (DRIVE.truth.json). Means and covariances of colours and shapes, and the
densities of trajectories, stay those of the models at hand; thresholds are replaced.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.files.writing import write_file
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.learning.asked import (
    TRAJECTORIES,
    ClassifierSamples,
    gather_samples,
    join_drives,
)
from wayside.pipeline.learning.fits import SIDES, sides
from wayside.pipeline.learning.labelled import ANY_SPACING_M, ON
from wayside.pipeline.learning.thresholds import with_learned_thresholds, with_score_threshold
from wayside.pipeline.models.model_files import (
    REPORT_LOCATION,
    TRAJECTORY_FILES,
    Models,
    load_models,
)
from wayside.pipeline.models.model_json import model_to_json
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel, MixtureModel

KANSAS, OWN = "report-kansas.json", {"color": "color_rgb.json", "shape": "shape.json"}

KANSAS_MEAN = (3.121, 0.603)
"""Mean place of a sign in the report: (1.9783, 10.2391) feet up and right of the camera (chapters 8 and 11)."""

OVERHEAD_M = 3.0
"""Panels so far above the camera hang over the road: on posts none stands so high."""

CHAINS = {"report-shape": ("shape",), "report": ("color", *TRAJECTORIES.values(), "location")}
"""By preset, the gates that are asked there about what really reaches them; the trajectories decide nothing there."""

FEWEST = 5
"""A component of fewer signs is not learned."""

Gate = TypeVar("Gate", GaussianModel, MixtureModel)

SIGMA_PER_MAD = 1.4826
"""Standard deviation of a normal distribution by its median absolute deviation."""


def learn_gates(
    samples: Mapping[str, ClassifierSamples], models: Models, densities: Sequence[MixtureModel] = ()
) -> dict[str, GaussianModel | MixtureModel]:
    """The models of the gates that were asked, by the name of their file; raises InputError where too few signs were.

    `samples`: by classifier. `densities`: of trajectories, one a form.
    """
    learned: dict[str, GaussianModel | MixtureModel] = {}
    # nine knees, one a shape, together accept half of all regions
    gates = (("color", models.color_classes, False), ("shape", models.shape_classes, True))
    for name, model, one_knee in gates:
        if name in samples and model is not None:
            found = with_learned_thresholds(model, samples[name], one_knee=one_knee)
            learned[OWN[name]] = _of_origin(found, "thresholds by", samples[name])
    for density in densities:
        name = TRAJECTORIES[density.space]
        if name in samples:
            scored = with_score_threshold(density, samples[name])
            learned[TRAJECTORY_FILES[density.space]] = _of_origin(
                scored, "threshold by", samples[name]
            )
    if "location" not in samples:
        return learned
    places = samples["location"]
    known, origin = places.known(), _origin(places)
    mixture = location_components(known.values[known.label == ON], origin)
    single = GaussianClass("report", np.array(KANSAS_MEAN), np.eye(2), 0.0, "", 50)
    kansas = "mean of 50 images of Kansas, unit covariance (report chapters 8 and 11); radius by "
    one = GaussianModel("right_up_m", (single,), kansas + origin)
    for file, gate in ((REPORT_LOCATION, mixture), (KANSAS, one)):
        learned[file] = with_learned_thresholds(gate, places)
    return learned


def trajectory_densities(options: Mapping[str, object]) -> tuple[MixtureModel, ...]:
    """The density of each form; options: settings by name, as `models.folder`."""
    every = (
        load_models(load_settings("report-2d", None, [f"report.trajectory={form}"], options)[0])
        for form in TRAJECTORY_FILES
    )
    return tuple(one.trajectory_density for one in every if one.trajectory_density is not None)


def location_components(places: NDArray[np.float64], provenance: str) -> GaussianModel:
    """Where signs stand, places (n, 2) right and up in metres: a component each right, left of and above the road.

    Mean and scatter are the median and the median absolute deviation: a few landmarks stand far from their sign. One
    mean cannot hold the signs on both sides (chapter 8 has it at +10 ft). Thresholds are still to be learned. Raises
    InputError where no component has `FEWEST` signs.
    """
    side, classes = sides(places, OVERHEAD_M), []
    for name in SIDES:
        own = side == name
        if own.sum() < FEWEST:
            continue
        mean = np.median(places[own], axis=0)
        scatter = SIGMA_PER_MAD * np.median(np.abs(places[own] - mean), axis=0)
        classes.append(GaussianClass(name, mean, np.diag(scatter**2), 0.0, "", int(own.sum())))
    if not classes:
        raise InputError(
            f"location: {FEWEST} landmarks of signs on a side of the road are needed, and there are {len(places)} in "
            "all. Label more images."
        )
    return GaussianModel("right_up_m", tuple(classes), provenance)


def _of_origin(model: Gate, what: str, samples: ClassifierSamples) -> Gate:
    """The model with the provenance of its new thresholds behind its own."""
    learned_from = re.split(r"; (?:thresholds?|operating points) by ", model.provenance)[0]
    return replace(model, provenance=f"{learned_from}; {what} {_origin(samples)}")


def _origin(samples: ClassifierSamples) -> str:
    """What was counted: drives, with their signs and other things."""
    own = samples.known()
    drives = []
    for name in np.unique(own.drive):
        mine = own.drive == name
        on = int(own.count[mine & (own.label == ON)].sum())
        drives.append(f"{name} ({on} signs, {int(own.count[mine].sum()) - on} others)")
    return f"rendered drives {', '.join(drives)}; seed 1; numpy {np.__version__}"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m wayside.pipeline.learning.gates")
    parser.add_argument("logs", type=Path, nargs="+", help="rendered drives with their truth")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the model files")
    given = parser.parse_args(arguments)
    learned: dict[str, GaussianModel | MixtureModel] = {}
    given.out.mkdir(parents=True, exist_ok=True)
    folder = {"models.folder": str(given.out), "read.spacing_m": ANY_SPACING_M}
    densities = trajectory_densities(folder)
    for preset, wanted in CHAINS.items():
        settings, _ = load_settings(preset, None, [], folder)
        models = load_models(settings)
        truths = [(log, read_labels(log.with_suffix(".truth.json"))) for log in given.logs]
        drives = [
            gather_samples(log, truth, settings, models, undecided=densities, only=wanted)
            for log, truth in truths
        ]
        learned |= learn_gates(join_drives(drives), models, densities)
    for name, model in learned.items():
        write_file(given.out / name, model_to_json(model).encode(), overwrite=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
