"""The learning of the kinds of posts."""

import numpy as np
import pytest

from training.learn_posts import DRAWS, FEWEST, post_choice, post_model
from wayside.schemas.errors import InputError
from wayside.stages.panel.posts import KINDS, PostEdges, Strip


def choice(kind, width, true=0.1):
    """A post of a width and kind by the truth, and likely edges of that width and of twice the width."""
    offset = np.arange(-100, 101) * 0.005
    strip = Strip(np.full((30, 201, 3), 90, np.float32), offset, 0.01, 1.0)
    sides = (np.array([[-one / 2, one / 2]]) for one in (width, 2 * width))
    likely = [PostEdges(each, float(np.diff(each)), 0.0, 4.0) for each in sides]
    return post_choice(strip, likely, {"posts": 1, "post": kind, "post_width_m": width * true})


def test_a_post_is_of_the_kind_that_is_as_wide_and_hidden_where_no_edges_are_right():
    widths = dict(zip(KINDS, (0.3, 0.05, 0.15, 0.08, 0.11), strict=True))
    choices = [choice(kind, wide, 1) for kind, wide in widths.items()] * FEWEST * DRAWS
    model = post_model(choices, "made by hand")
    for one in choices[: len(KINDS)]:
        assert [int((one.features @ model.weights).argmax())] == one.right
    assert choice("wood", 0.1, 3).right == [2 * len(KINDS)]


def test_too_few_posts_of_a_kind_are_told():
    choices = [choice(kind, 0.1, 1) for kind in KINDS[1:]] * FEWEST * DRAWS
    with pytest.raises(InputError, match="fewer than 10 of pole"):
        post_model(choices, "made by hand")
