"""Learn the kinds of posts from rendered drives whose posts vary: `python -m training.learn_posts`.

Kinds are Gaussians of `post_features` with one covariance (linear discriminant analysis). Panels are registered about
boxes drawn at random, as in `training.learn`. The same drives, seed and package versions give the same file.
"""

import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from training.learn import faces_shown, registered_face
from training.truth import (
    DRIVES,
    OUT,
    SEED,
    command,
    images,
    learning_logs,
    read_truth,
    write_model,
)
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import load_models
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.panel import POST_SPACE, post_below, post_features

DRAWS = 2
"""Boxes that are drawn for each face."""
LIKE_WIDTH = 1.5
"""Edges whose distance is so many times the true width, or the inverse, are of something else."""
FEWEST = 10
"""Posts of a kind below which nothing is learned."""


def learn_posts(drives: Path, out: Path, seed: int) -> None:
    """Learn `post.json` from the drives of a folder and write it into `out`.

    Raises InputError if drives are missing, unusable or show too few posts, OutputError if the file cannot be written.
    """
    outline, rng = load_models(load_settings()[0]).outline_weights, np.random.default_rng(seed)
    found: dict[str, list[NDArray[np.float64]]] = defaultdict(list)
    logs = learning_logs(drives)
    for log in logs:
        truth = read_truth(log)
        lowest = {s["assembly_id"]: s for s in sorted(truth["signs"], key=lambda s: -s["bottom_m"])}
        for sign, views in faces_shown(images(log), truth):
            if sign is not lowest[sign["assembly_id"]] or not sign.get("posts"):
                continue
            for face in (registered_face(sign, views, outline, rng) for _ in range(DRAWS)):
                if face is None:
                    break
                box = face.box if face.outline is None else face.outline.box
                strips, edges = post_below(face, box, sign["bottom_m"])
                near = np.log(LIKE_WIDTH)
                if edges and abs(np.log(edges.width_m / sign["post_width_m"])) < near:
                    found[sign["post"]].append(post_features(strips[0], edges))
    origin = f"rendered drives {', '.join(log.stem for log in logs)}; seed {seed}; numpy {np.__version__}"
    write_model(out / "post.json", post_model(found, origin))


def post_model(
    found: Mapping[str, Sequence[NDArray[np.float64]]], provenance: str
) -> GaussianModel:
    """The kinds by their posts, features (d,) each; raises InputError where a kind has too few posts."""
    few = [kind for kind, own in found.items() if len(own) < FEWEST * DRAWS]
    if few or not found:
        names = ", ".join(few) or "all kinds"
        raise InputError(f"posts: there are fewer than {FEWEST} of {names}. Add drives.")
    within: NDArray[np.float64] = np.mean(
        [np.cov(np.array(own).T) for own in found.values()], axis=0
    )
    classes = (
        GaussianClass(kind, np.round(np.array(own).mean(axis=0), 6), np.round(within, 9), len(own))
        for kind, own in sorted(found.items())
    )
    return GaussianModel(POST_SPACE, tuple(classes), provenance, threshold_rule="most probable")


main = command(__doc__, learn_posts, drives=DRIVES, out=OUT, seed=SEED)

if __name__ == "__main__":
    sys.exit(main())
