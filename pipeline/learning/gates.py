"""Learn the report's gates on labelled drives: densities of what is not a sign, thresholds, and places of signs.

    .venv/bin/python -m wayside.pipeline.learning.gates DRIVE.mcap ... -o MODELS

Each drive needs its truth in the same folder (DRIVE.truth.json). Means and covariances of colours and shapes, and the
densities of trajectories, stay those of the models at hand. Colours are learned first: other gates see what they pass.
"""

import argparse
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.files.writing import write_file
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.learning import asked, fits
from wayside.pipeline.learning.curves import resampled_groups
from wayside.pipeline.learning.labelled import ANY_SPACING_M, ON
from wayside.pipeline.learning.thresholds import GATE_RATES, Gate, with_threshold
from wayside.pipeline.models.model_files import (
    PANEL_SIZE,
    REPORT_LOCATION,
    TRAJECTORY_FILES,
    Models,
    load_models,
)
from wayside.pipeline.models.model_folder import ModelFolder
from wayside.pipeline.models.model_json import model_to_json
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel, MixtureModel
from wayside.schemas.settings import ReadSettings
from wayside.stages.classifiers import log_ratios
from wayside.stages.report import DESCRIPTORS

KANSAS, OWN = "report-kansas.json", {"color": "color_rgb.json", "shape": "shape.json"}

KANSAS_MEAN = (3.121, 0.603)
"""Mean place of a sign in the report: (1.9783, 10.2391) feet up and right of the camera (chapters 8 and 11)."""

OVERHEAD_M = 3.0
"""Panels higher than this above the camera hang over the road: no panel on posts is as high."""

PASSES = (
    ("report-shape", ("color",)),
    ("report-shape", ("shape",)),
    ("report", (*asked.TRAJECTORIES.values(), "location", "panel_size")),
)
"""Preset of each pass over the drives, and the gates learned there; the trajectories decide nothing in theirs."""

FEWEST = 20
"""A component with fewer signs is not learned: its scatter would be known to a sixth at best."""


def learn_gates(
    samples: Mapping[str, asked.ClassifierSamples],
    models: Models,
    densities: Sequence[MixtureModel] = (),
) -> dict[str, GaussianModel | MixtureModel]:
    """The models of the gates that were asked, by the name of their file; raises InputError where too few signs were.

    `samples`: by classifier. `densities`: of trajectories, one a form.
    """
    learned: dict[str, GaussianModel | MixtureModel] = {}
    floors = {"color": fits.COLOR_FLOOR, "shape": (fits.SHAPE_FLOOR,) * DESCRIPTORS}
    for name, model in (("color", models.color_classes), ("shape", models.shape_classes)):
        if name in samples and model is not None:
            own = samples[name]
            found = _gate(own, partial(_against, model, floors[name]), name)
            learned[OWN[name]] = _of_origin(found, "background and threshold by", own)
    for density in densities:
        name = asked.TRAJECTORIES[density.space]
        if name in samples:
            own = samples[name].known()
            columns = own.values[:, 0], own.label == ON, resampled_groups(own.drive, own.frame)[0]
            scored = with_threshold(density, *columns, GATE_RATES["trajectory"])
            learned[TRAJECTORY_FILES[density.space]] = _of_origin(scored, "threshold by", own)
    if "location" not in samples:
        return learned
    places, origin = samples["location"], _origin(samples["location"])
    single = GaussianClass("report", np.array(KANSAS_MEAN), np.eye(2), 50)
    kansas = "mean of 50 images of Kansas, unit covariance (report chapters 8 and 11); radius by "
    one = GaussianModel("right_up_m", (single,), kansas + origin)

    def stand(known: asked.ClassifierSamples) -> GaussianModel:
        signs = known.values[known.label == ON]
        # one mean cannot hold the signs on both sides (chapter 8 has it at +10 ft)
        sides = fits.side_classes(signs, OVERHEAD_M, FEWEST)
        if not sides:
            raise InputError(
                f"location: {FEWEST} landmarks of signs on a side of the road are needed, and there are {len(signs)} "
                "in all. Label more images."
            )
        return _against(GaussianModel("right_up_m", tuple(sides), origin), fits.PLACE_FLOOR, known)

    learned[REPORT_LOCATION] = _gate(places, stand, "location")
    learned[KANSAS] = _gate(places, lambda known: one, "location")
    own, floor = samples["panel_size"].known(), (0.0, 0.0)
    sign = fits.class_of("sign", own.values[own.label == ON], floor)
    other = fits.class_of("other", own.values[own.label != ON], floor)
    learned[PANEL_SIZE] = GaussianModel("log_m", (sign,), origin, (other,))
    return learned


def _against(
    model: GaussianModel, floor: Sequence[float], known: asked.ClassifierSamples
) -> GaussianModel:
    """The model with the background of what is no sign."""
    others = known.values[known.label != ON]
    return replace(model, background=fits.fit_background(others, lambda mean: np.array(floor)))


def _gate(
    samples: asked.ClassifierSamples,
    fit: Callable[[asked.ClassifierSamples], GaussianModel],
    name: str,
) -> GaussianModel:
    """The model fitted to all samples, with a threshold by the scores of drives that were held out in turn."""
    known = samples.known()
    group, _ = resampled_groups(known.drive, known.frame)
    score = np.empty(len(known))
    for one in np.unique(group):
        held = group == one
        score[held] = log_ratios(known.values[held], fit(known.select(~held))).max(axis=1)
    return with_threshold(fit(known), score, known.label == ON, group, GATE_RATES[name])


def trajectory_densities(folder: ModelFolder) -> tuple[MixtureModel, ...]:
    """The density of each form."""
    return tuple(folder.read(name, MixtureModel) for name in TRAJECTORY_FILES.values())


def _of_origin(model: Gate, what: str, samples: asked.ClassifierSamples) -> Gate:
    """The model with the provenance of its new threshold after its own."""
    learned_from = re.split(r"; (?:background and )?thresholds? by ", model.provenance)[0]
    return replace(model, provenance=f"{learned_from}; {what} {_origin(samples)}")


def _origin(samples: asked.ClassifierSamples) -> str:
    """Words for the samples: drives, with their signs and other things."""
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
    given.out.mkdir(parents=True, exist_ok=True)
    densities = trajectory_densities(ModelFolder(given.out))
    every = ReadSettings(spacing_m=ANY_SPACING_M)
    truths = [(log, read_labels(log.with_suffix(".truth.json"))) for log in given.logs]
    faces = [(log, asked.faces_of_log(log, truth, every)) for log, truth in truths]
    for preset, wanted in PASSES:
        folder = str(given.out) if (given.out / OWN["color"]).is_file() else ""
        options = {"models.folder": folder, "read.spacing_m": ANY_SPACING_M}
        settings, _ = load_settings(preset, None, [], options)
        models = load_models(settings)
        if models.color_classes is not None and "color" in wanted:  # nothing behind it is asked
            models = replace(models, color_classes=replace(models.color_classes, threshold=np.inf))
        drives = [
            asked.gather_samples(log, own, settings, models, undecided=densities, only=wanted)
            for log, own in faces
        ]
        for name, model in learn_gates(asked.join_drives(drives), models, densities).items():
            write_file(given.out / name, model_to_json(model).encode(), overwrite=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
