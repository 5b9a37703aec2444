"""Whether a model was learned from a log, by what it says of itself."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import (
    learned_from,
    load_models,
    onnx_metadata,
    shipped_models,
)

TEXT = (
    "rendered drives learn_alley (60 images, 197 faces), learn_town (9 images, 1 faces); seed 1; "
    "rendered/tune_hill: 22 images, own; us_clip: 42 images, MIT (upstream); town, held out: 5 of 9"
)


@pytest.mark.parametrize("log", ["learn_alley", "learn_town", "tune_hill", "us_clip"])
def test_a_log_that_is_listed_with_its_images_was_learned_from(log):
    assert learned_from(log, {"box": TEXT, "place": "seed 1"}) == ("box",)


@pytest.mark.parametrize("log", ["alley", "learn", "hill", "us", "clip", "town", "seed", "us.clip"])
def test_a_part_of_a_name_or_a_word_of_the_text_is_no_source(log):
    assert learned_from(log, {"box": TEXT}) == ()


def test_the_models_that_ship_name_the_real_drives_they_saw():
    settings, _ = load_settings("default", None, [], {})
    said = load_models(settings).provenances()
    of_one_image = {"box", "network"}
    assert of_one_image <= set(learned_from("us_freeway_challenge", said))
    assert of_one_image <= set(learned_from("ca_city_garmin", said))
    without, _ = load_settings("default", None, [], {"models.network": ""})
    assert "network" not in learned_from("us_freeway_challenge", load_models(without).provenances())


def test_the_models_that_ship_name_the_rendered_drives_they_saw():
    settings, _ = load_settings("default", None, [], {})
    said = load_models(settings).provenances()
    assert set(learned_from("learn_alley", said)) == {"box", "location", "network", "outline"}
    assert set(learned_from("learn_alley_90000", said)) == {"network"}
    of_thresholds = {"place", "back_place", "front", "back"}
    assert of_thresholds <= set(learned_from("learn_alley_70000", said))
    for never in ("demo", "straight", "curve", "town", "report", "raw"):
        assert learned_from(never, said) == ()


def test_the_metadata_of_an_onnx_file_is_read():
    said = onnx_metadata((shipped_models() / "network.onnx").read_bytes())
    assert said["seed"].isdigit()
    assert "us_freeway_white_right: 45 images" in said["sources"]


@given(st.binary(max_size=200))
def test_a_file_that_is_no_onnx_has_no_metadata_or_readable_one(content):
    assert all(isinstance(text, str) for text in onnx_metadata(content).values())
