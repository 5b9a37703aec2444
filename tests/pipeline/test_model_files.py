import json

import pytest

from wayside.pipeline.model_files import load_models, shipped_models
from wayside.pipeline.settings_file import load_settings
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError
from wayside.schemas.models import digest, model_from_json, model_to_json
from wayside.stages.detection.detector import check_network, gate_names, view_names
from wayside.stages.detection.region_features import REGION_FEATURES
from wayside.stages.mapping.landmark_features import FEATURES

NAMES = (
    "back.json",
    "back_place.json",
    "color.json",
    "color_rgb.json",
    "face_box.json",
    "face_color.json",
    "face_shape.json",
    "judge.json",
    "location.json",
    "place.json",
    "ranking.json",
    "shape.json",
    "shape_oriented.json",
)


def settings(preset="default", folder=""):
    given = {"models.folder": str(folder)} if folder else {}
    return load_settings(preset, None, [], given)[0]


@pytest.mark.parametrize("name", NAMES)
def test_a_model_that_ships_reads_and_writes_the_same_bytes(name):
    text = (shipped_models() / name).read_text()
    assert model_to_json(model_from_json(text, name)) == text


@pytest.mark.parametrize("name", NAMES)
def test_a_model_that_ships_says_where_it_comes_from(name):
    assert "learn_" in model_from_json((shipped_models() / name).read_text()).provenance


def test_the_judge_knows_the_features_that_the_stage_computes():
    judge = load_models(settings()).judge
    assert judge.features == view_names()
    assert judge.gate is not None
    assert judge.gate.features == gate_names()


def test_the_judge_of_backs_and_the_ranking_know_the_features_that_the_stages_compute():
    models = load_models(settings())
    assert models.back is not None
    assert models.back.features == view_names()
    assert models.back_place is not None
    assert models.back_place.features == FEATURES
    assert models.ranking is not None
    assert models.ranking.features == REGION_FEATURES


def test_the_judge_of_places_knows_the_features_that_the_stage_computes():
    place = load_models(settings()).place
    assert place is not None
    assert place.features == FEATURES


def test_the_networks_that_name_faces_know_features_and_names_of_the_stages():
    models = load_models(settings())
    check_network(models.face_color, COLORS)
    check_network(models.face_shape, SHAPES)


def test_the_report_names_faces_by_its_own_classifiers_alone():
    models = load_models(settings("report"))
    assert models.face_color is None
    assert models.face_shape is None


def test_each_preset_has_its_own_colours_shapes_and_places():
    default, report = load_models(settings()), load_models(settings("report"))
    assert (default.color.space, report.color.space) == ("log_chromaticity", "rgb")
    assert (default.shape.space, report.shape.space) == ("fourier6_oriented", "fourier6")
    assert [c.name for c in report.location.classes] == ["report"]
    assert "report" not in [c.name for c in default.location.classes]


def test_digests_are_those_of_the_files_and_the_same_each_time():
    one, other = load_models(settings()).digests(), load_models(settings()).digests()
    assert one == other
    assert one["judge"] == digest((shipped_models() / "judge.json").read_text())


def test_a_file_of_ones_own_replaces_the_one_that_ships(tmp_path):
    data = json.loads((shipped_models() / "color.json").read_text())
    data["provenance"] = "my own"
    (tmp_path / "color.json").write_text(json.dumps(data))
    models = load_models(settings(folder=tmp_path))
    assert models.color.provenance == "my own"
    assert models.judge.provenance == load_models(settings()).judge.provenance


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"models\.folder"):
        load_models(settings(folder=tmp_path / "none"))


def test_a_file_of_the_wrong_kind_is_refused_with_its_name(tmp_path):
    (tmp_path / "judge.json").write_text((shipped_models() / "color.json").read_text())
    with pytest.raises(InputError, match=r"judge\.json: wanted a model of kind 'trees'"):
        load_models(settings(folder=tmp_path))


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"kind": "gaussian"}', '{"kind": "fish"}'])
def test_a_file_that_is_no_model_is_refused_with_its_name(tmp_path, text):
    (tmp_path / "color.json").write_text(text)
    with pytest.raises(InputError, match=r"color\.json"):
        load_models(settings(folder=tmp_path))


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "color.json").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="readable"):
        load_models(settings(folder=tmp_path))
