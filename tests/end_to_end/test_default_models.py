"""Models of one's own folder take part in the decisions of a run."""

import json
from importlib.resources import files

import pytest

SHORT = ("--until", "0.4")


@pytest.fixture(scope="module")
def run_with(run_demo, tmp_path_factory):
    """Run the first frames of the demo with some model files changed by a function each."""

    def run(**changes):
        folder = tmp_path_factory.mktemp("models")
        for name, change in changes.items():
            text = (files("wayside.pipeline") / "models" / f"{name}.json").read_text()
            (folder / f"{name}.json").write_text(json.dumps(change(json.loads(text))))
        return run_demo(*SHORT, "--set", f"models.folder={folder}")

    return run


def far_away(model):
    """The same classes a kilometre above the road."""
    classes = [one | {"mean": [one["mean"][0], 1000.0]} for one in model["classes"]]
    return model | {"classes": classes}


def test_where_the_location_model_has_no_sign_is_evidence_against_one(run_with):
    usual, far = (
        [row for row in result.signs if row["status"] == "sign"]
        for result in (run_with(), run_with(location=far_away))
    )
    assert usual
    least = min(row["evidence_place"] for row in usual)
    assert all(row["evidence_place"] < least for row in far)
    assert sum(row["confidence"] for row in far) < sum(row["confidence"] for row in usual)


def test_a_panel_larger_than_the_settings_allow_is_none(run_demo):
    result = run_demo(*SHORT, "--set", "locate.largest_side_m=0.85")
    assert max(row["panel_width_m"] for row in result.signs) <= 0.85
    assert result.verdicts["panel_size"] > 0


def name_everything(name):
    """A change of a network that makes it sure of one class."""

    def change(model):
        place = model["classes"].index(name)
        bias = [30.0 if k == place else -30.0 for k in range(len(model["classes"]))]
        return model | {"output_bias": bias}

    return change


def test_the_networks_of_faces_name_colors_and_shapes(run_with):
    result = run_with(face_color=name_everything("blue"), face_shape=name_everything("circle"))
    faces = [row for row in result.signs if row["status"] == "sign"]
    assert {(row["color"], row["shape"]) for row in faces} == {("blue", "circle")}
