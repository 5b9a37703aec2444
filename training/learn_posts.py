"""Learn the kinds of posts from rendered drives whose posts vary: `python -m training.learn_posts`.

Each kind is one Gaussian of `post_features`. Panels are found and registered about boxes drawn at random, as in
`training.learn`. The same drives, seed and package versions give the same file.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

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
from wayside.stages.panel import (
    POST_SPACE,
    find_posts,
    outline_of,
    post_features,
    strips_below,
)

DRAWS = 4
"""Boxes that are drawn for each face."""
LIKE_WIDTH = 1.5
"""Edges whose distance is so many times the true width, or the inverse, are of something else."""
SHRINKAGE = 0.1
"""Part of the covariance of all kinds together in that of each: few posts do not show theirs alone."""
FEWEST = 10
"""Posts of a kind below which nothing is learned."""
RULE = "none: the most probable kind, or unknown"


def learn_posts(drives: Path, out: Path, seed: int) -> None:
    """Learn `post.json` from the drives of a folder and write it into `out`.

    Raises InputError if drives are missing, cannot be used or show too few posts; OutputError if the file cannot be
    written.
    """
    settings, _ = load_settings()
    outline, rng = load_models(settings).outline_weights, np.random.default_rng(seed)
    found: dict[str, list[np.ndarray]] = {}
    logs = learning_logs(drives)
    for log in logs:
        truth = read_truth(log)
        lowest = {s["assembly_id"]: s for s in sorted(truth["signs"], key=lambda s: -s["bottom_m"])}
        for sign, views in faces_shown(images(log), truth):
            if sign is not lowest[sign["assembly_id"]] or not sign.get("posts"):
                continue
            for _ in range(DRAWS):
                face = registered_face(sign, views, outline, rng)
                if face is None:
                    break
                registered, size = face
                seen = outline_of(registered, size, outline)
                box = registered.box(size) if seen is None else seen.box
                strips = strips_below(registered, box, sign["bottom_m"])
                edges = find_posts(strips, sign["width_m"]) if strips else None
                if edges is not None:
                    wide = edges.width_m / sign["post_width_m"]
                    if 1 / LIKE_WIDTH < wide < LIKE_WIDTH:
                        found.setdefault(sign["post"], []).append(post_features(strips[0], edges))
    origin = f"rendered drives {', '.join(log.stem for log in logs)}; seed {seed}; numpy {np.__version__}"
    write_model(out / "post.json", post_model(found, origin))


def post_model(found: dict[str, list[np.ndarray]], provenance: str) -> GaussianModel:
    """One Gaussian for each kind, by features (n, d); raises InputError where a kind has too few posts."""
    few = [kind for kind, own in found.items() if len(own) < FEWEST * DRAWS]
    if few or not found:
        raise InputError(
            f"posts: there are fewer than {FEWEST} of {', '.join(few) or 'all kinds'}. Add drives."
        )
    within = np.mean([np.cov(np.array(own).T) for own in found.values()], axis=0)
    classes = [
        GaussianClass(
            kind,
            np.round(np.mean(own, axis=0), 6),
            np.round((1 - SHRINKAGE) * np.cov(np.array(own).T) + SHRINKAGE * within, 9),
            len(own),
        )
        for kind, own in sorted(found.items())
    ]
    return GaussianModel(POST_SPACE, tuple(classes), provenance, threshold_rule=RULE)


main = command(__doc__, learn_posts, drives=DRIVES, out=OUT, seed=SEED)

if __name__ == "__main__":
    sys.exit(main())
