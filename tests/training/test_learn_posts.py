"""The learning of the kinds of posts."""

import numpy as np
import pytest

from training.learn_posts import DRAWS, FEWEST, post_model
from wayside.schemas.errors import InputError
from wayside.stages.panel import FEATURES
from wayside.stages.panel.posts import kind_of


def posts(middle, count):
    return list(np.random.default_rng(middle).normal(middle, 1.0, (count, FEATURES)))


def test_a_post_is_of_the_kind_whose_posts_it_is_like():
    found = {"wood": posts(0, FEWEST * DRAWS), "pole": posts(4, 2 * FEWEST * DRAWS)}
    model = post_model(found, "made by hand")
    assert [kind_of(np.full(FEATURES, mean), model)[0] for mean in (0.2, 3.9)] == ["wood", "pole"]


def test_too_few_posts_of_a_kind_are_told():
    found = {"wood": posts(0, FEWEST * DRAWS), "pole": posts(4, FEWEST * DRAWS - 1)}
    for few in (found, {}):
        with pytest.raises(InputError, match="pole" if few else "all kinds"):
            post_model(few, "made by hand")
