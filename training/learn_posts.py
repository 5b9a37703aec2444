"""Learn the edges and kinds of posts from rendered drives whose posts vary: `python -m training.learn_posts`.

The weights maximise the likelihood of the true kind and width, and of hidden posts where no likely edges are so wide.
Boxes are drawn at random as in `training.learn`. The same drives, seed and package versions give the same file.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from training.learn import OutlineChoice, faces_shown, fitted, registered_face
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
from wayside.schemas.models import LinearModel
from wayside.stages.panel import POST_FEATURES, posts
from wayside.stages.panel.posts import KINDS

DRAWS = 2
"""Boxes that are drawn for each face."""
LIKE_WIDTH = 1.22
"""Edges whose distance is so many times the true width, or the inverse, are of something else."""
FEWEST = 10
"""Posts of a kind below which nothing is learned."""


def learn_posts(drives: Path, out: Path, seed: int) -> None:
    """Learn `post.json` from the drives of a folder and write it into `out`.

    Raises InputError if drives are missing, unusable or show too few posts, OutputError if the file cannot be written.
    """
    outline, rng = load_models(load_settings()[0]).outline_weights, np.random.default_rng(seed)
    logs, choices = learning_logs(drives), list[OutlineChoice]()
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
                strips, likely = posts.posts_below(face, box, sign["bottom_m"])
                choices += [post_choice(strips[0], likely, sign)] if likely else []
    origin = f"rendered drives {', '.join(log.stem for log in logs)}; seed {seed}; numpy {np.__version__}"
    write_model(out / "post.json", post_model(choices, origin))


def post_choice(
    strip: posts.Strip, likely: Sequence[posts.PostEdges], sign: Mapping[str, Any]
) -> OutlineChoice:
    """The likely posts of each kind, then hidden ones; which of them are right by the truth of a sign."""
    features = posts.post_features(strip, likely).reshape(-1, len(POST_FEATURES))
    off = [abs(np.log(one.width_m / sign["post_width_m"])) for one in likely]
    same = [len(one.sides_m) == sign["posts"] for one in likely]
    rows = np.flatnonzero(np.where(same, off, np.inf) < np.log(LIKE_WIDTH)) * len(KINDS)
    right = (rows + KINDS.index(sign["post"])).tolist() or [len(features)]
    return OutlineChoice(np.vstack([features, 0 * features[:1]]), right, "")


def post_model(choices: Sequence[OutlineChoice], provenance: str) -> LinearModel:
    """The weights by choices of `post_choice`; raises InputError where a kind has too few posts."""
    shown = [c.right[0] % len(KINDS) for c in choices if c.right[0] < len(c.features) - 1]
    few = [kind for n, kind in enumerate(KINDS) if shown.count(n) < FEWEST * DRAWS]
    if few:
        raise InputError(f"posts: there are fewer than {FEWEST} of {', '.join(few)}. Add drives.")
    return LinearModel(POST_FEATURES, fitted(choices), provenance)


main = command(__doc__, learn_posts, drives=DRIVES, out=OUT, seed=SEED)

if __name__ == "__main__":
    sys.exit(main())
