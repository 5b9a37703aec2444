import json
from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.errors import InputError
from wayside.schemas.model_json import model_from_json, model_to_json
from wayside.schemas.models import NetworkModel, TreeModel
from wayside.stages.classifiers.trees import log_odds


def stump(threshold=0.5, low=-1.0, high=2.0, bias=0.25):
    """One tree: `low` up to the threshold of feature "b", `high` above."""
    return TreeModel(
        ("a", "b"),
        bias,
        np.array([[1, 0, 0]], np.int32),
        np.array([[threshold, 0, 0]], np.float32),
        np.array([[1, -1, -1]], np.int32),
        np.array([[2, -1, -1]], np.int32),
        np.array([[0, low, high]], np.float32),
        0.0,
        "made by hand",
    )


def test_a_value_goes_left_up_to_the_threshold_and_where_it_is_nan():
    values = np.array([[0, 0.5], [0, 0.51], [9, -3], [0, np.nan]], np.float32)
    assert log_odds(stump(), values).tolist() == [-0.75, 2.25, -0.75, -0.75]


def test_no_rows_give_no_scores():
    assert log_odds(stump(), np.zeros((0, 2), np.float32)).shape == (0,)


def test_another_number_of_features_is_refused():
    with pytest.raises(ValueError, match="values"):
        log_odds(stump(), np.zeros((3, 5), np.float32))


@pytest.mark.parametrize(
    "changes",
    [
        {"left": [[7, -1, -1]]},
        {"right": [[-5_000_000, -1, -1]]},
        {"left": [[0, -1, -1]]},
        {"feature": [[-1_000_000, 0, 0]]},
        {"feature": [[2, 0, 0]]},
        {"value": [[0.0, -1.0]]},
        {"split": [[]]},
    ],
)
def test_a_tree_that_leads_out_of_its_arrays_cannot_be_made(changes):
    arrays = {
        name: np.array(value, np.int32 if name in ("left", "right", "feature") else np.float32)
        for name, value in changes.items()
    }
    with pytest.raises(ValueError, match="damaged"):
        replace(stump(), **arrays)


def test_exported_trees_give_the_scores_of_scikit_learn():
    pytest.importorskip("sklearn", reason="scikit-learn is only needed for learning")
    from wayside.pipeline.learning.boosting import Boosting, exported_trees, fit_trees

    rng = np.random.default_rng(3)
    values = rng.normal(size=(600, 5)).astype(np.float32)
    positive = values[:, 0] * values[:, 1] + 0.3 * rng.normal(size=600) > 0.2
    fitted = fit_trees(values, positive, None, Boosting(trees=30, leaves=8), seed=1)
    model = exported_trees(fitted, tuple("abcde"), -1.0, "test")
    read = model_from_json(model_to_json(model))
    assert isinstance(read, TreeModel)
    fresh = rng.normal(size=(400, 5)).astype(np.float32)
    for one in (model, read):
        assert log_odds(one, fresh) == pytest.approx(fitted.log_odds(fresh), abs=1e-4)


def test_a_part_of_another_kind_is_refused_with_the_file_named():
    data = json.loads(model_to_json(stump()))
    data["network"] = {"kind": "gaussian", "space": "rgb", "classes": [], "provenance": ""}
    with pytest.raises(InputError, match=r"judge\.json"):
        model_from_json(json.dumps(data), "judge.json")


def adding(by):
    """A network that says the value of feature "b", `by` times."""
    return NetworkModel(
        ("a", "b"),
        ("log_odds",),
        np.zeros(2, np.float32),
        np.ones(2, np.float32),
        np.array([[0, 0], [1, -1]], np.float32),
        np.zeros(2, np.float32),
        np.array([[by], [-by]], np.float32),
        np.zeros(1, np.float32),
        "made by hand",
    )


def test_what_a_network_beside_the_trees_says_is_added():
    both = replace(stump(), network=adding(2.0))
    values = np.array([[0, 0.25], [0, 3.0], [0, -1.0]], np.float32)
    assert log_odds(both, values).tolist() == [-0.25, 8.25, -2.75]
    read = model_from_json(model_to_json(both))
    assert log_odds(read, values).tolist() == [-0.25, 8.25, -2.75]
