"""The learning of the kinds of posts."""

import numpy as np
import pytest

from training.learn_posts import DRAWS, FEWEST, post_choice, post_model
from wayside.schemas.errors import InputError
from wayside.stages.panel.posts import KINDS, PostEdges, Strip


def choice(kind, width, true):
    """A post of a kind and width by the truth, and likely edges of a width and of twice that."""
    strip = Strip(np.full((30, 201, 3), 90, np.float32), np.arange(-100, 101) * 0.005, 0.01, 1.0)
    wide = (width, 2 * width)
    likely = [PostEdges(np.array([[-one / 2, one / 2]]), one, 0.0, 4.0) for one in wide]
    return post_choice(strip, likely, {"posts": 1, "post": kind, "post_width_m": true})


def test_a_post_is_of_the_kind_that_is_as_wide_and_hidden_where_no_edges_are_right():
    widths = zip(KINDS, (0.3, 0.05, 0.15, 0.08, 0.11), strict=True)
    choices = [choice(kind, wide, wide) for kind, wide in widths]
    model = post_model(choices * FEWEST * DRAWS, "made by hand")
    assert [[(one.features @ model.weights).argmax()] for one in choices] == [
        c.right for c in choices
    ]
    assert choice("wood", 0.1, 0.3).right == [2 * len(KINDS)]
    with pytest.raises(InputError, match="fewer than 10 of pole"):
        post_model(choices[1:] * FEWEST * DRAWS, "made by hand")
