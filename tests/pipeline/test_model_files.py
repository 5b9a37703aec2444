"""Model files: those that ship, those of a user's own, what is refused, and where they were learned."""

import json
import math
import re
from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import learned_from, load_models, onnx_metadata
from wayside.pipeline.models.model_folder import shipped_digests, shipped_models
from wayside.pipeline.models.model_json import digest, model_from_json, model_to_json
from wayside.schemas.errors import InputError, UsageError
from wayside.stages.mapping import FEATURES
from wayside.stages.panel import OUTLINE_FEATURES

NAMES = sorted(file.name for file in shipped_models().iterdir() if file.name.endswith(".json"))
NETWORKS = {"box.onnx": "box", "face_code.onnx": "face_code", "network.onnx": "network"}


def settings(preset="default", folder="", **more):
    given = {"models.folder": str(folder)} if folder else {}
    given |= {f"models.{name}": value for name, value in more.items()}
    return load_settings(preset, None, [], given)[0]


@cache
def models_of(preset):
    """The models that ship, of a preset."""
    return load_models(settings(preset))


@pytest.fixture
def shipped():
    """Those of the default preset."""
    return models_of("default")


@pytest.mark.parametrize("name", NAMES)
def test_a_model_that_ships_is_written_as_it_was_read_and_says_where_it_comes_from(name):
    text = (shipped_models() / name).read_text()
    model = model_from_json(text, name)
    assert json.loads(model_to_json(model)) == json.loads(text)
    # the drives that the outlines were learned from were not recorded
    assert ("rendered drives" if name == "outline.json" else "learn_") in model.provenance


def test_the_models_that_ship_name_the_drives_they_saw_and_none_that_is_for_tests_only(shipped):
    said = shipped.provenances()
    only_tests = ("scenes/mb", "de_road_kitti0015", "de_city_kitti0001", "de_autobahn")
    for source in (*only_tests, "demo", "straight", "curve", "town", "report", "raw"):
        assert learned_from(source, said) == ()
    for source in ("us_freeway_challenge", "ca_city_garmin"):
        assert {"box", "network"} <= set(learned_from(source, said))
    assert set(learned_from("learn_alley", said)) == {"box", "location", "network", "outline"}
    assert set(learned_from("learn_alley_90000", said)) == {"network"}
    of_thresholds = {"place", "back_place", "front", "back"}
    assert of_thresholds <= set(learned_from("learn_alley_70000", said))


def test_every_shipped_model_says_what_it_was_learned_from_and_how_its_threshold_was_chosen(
    shipped,
):
    report = models_of("report")
    for models in (shipped, report, models_of("report-shape")):
        said = models.provenances()
        assert all(said.values())
        assert said.keys() == models.digests().keys()
    boxes = [(model, "alpha: ") for model in (shipped.front_scores, shipped.back_scores)]
    gates = (report.color_classes, report.location_classes, models_of("report-shape").shape_classes)
    for model, rule in (*boxes, *((one, "alpha 0.") for one in gates)):
        assert model.threshold_rule.startswith(rule)
        low, high = model.threshold_interval
        assert low <= model.threshold <= high
    for gate in gates:
        assert gate.background
    assert all(one.count >= 20 for one in report.location_classes.classes)
    joined = shipped.front_scores.with_network
    assert min(joined.own, joined.network) > 0
    assert shipped.back_scores.with_network is None


def test_models_know_the_features_that_their_stages_compute(shipped):
    for model in (shipped.landmark_classifier, shipped.back_landmark_classifier):
        assert set(model.features) == set(FEATURES)
    for preset in ("default", "report"):
        assert models_of(preset).outline_weights.features == OUTLINE_FEATURES


@pytest.mark.parametrize("form", ["image", "compensated"])
def test_the_trajectory_model_is_that_of_the_form_asked_for(form):
    chosen, _ = load_settings("report-2d", None, [f"report.trajectory={form}"])
    model = load_models(chosen).trajectory_density
    assert model.space == form
    assert model.threshold_rule.startswith("alpha 0.")


def test_each_preset_has_its_own_colours_shapes_and_places(shipped):
    default, report = shipped, models_of("report")
    assert report.box_network is report.front_scores is report.back_scores is None
    assert report.face_network is report.trajectory_density is None
    assert default.color_classes is default.shape_classes is None
    assert (report.color_classes.space, report.shape_classes) == ("rgb", None)
    assert models_of("report-shape").shape_classes.space == "fourier8"
    assert [c.name for c in report.location_classes.classes] == ["right", "left", "overhead"]
    assert report.location_classes.provenance != default.location_classes.provenance


def test_the_mean_of_the_report_stands_as_a_location_model_of_its_own():
    gate = load_models(settings("report", location="report-kansas")).location_classes
    (kansas,) = gate.classes
    feet = 0.3048
    assert kansas.mean == pytest.approx([10.2391 * feet, 1.9783 * feet], abs=1e-3)
    assert kansas.covariance.tolist() == [[1, 0], [0, 1]]
    assert gate.threshold_rule.startswith("alpha 0.")
    with pytest.raises(InputError, match=r"no model file at nowhere.*report-kansas"):
        load_models(settings("report", location="nowhere"))


def test_a_false_alarm_rate_trades_every_gate_of_the_report_that_has_a_curve(tmp_path):
    shipped = models_of("report")
    strict, loose = (load_models(settings("report", alpha=alpha)) for alpha in ("0.02", "0.5"))
    for gate in ("color_classes", "location_classes"):
        assert getattr(strict, gate).threshold > getattr(loose, gate).threshold
        assert getattr(strict, gate).threshold_rule.startswith("alpha 0.02")
    assert strict.digests() != shipped.digests()
    folder = with_curve(tmp_path, "trajectory.json")
    density = load_models(settings("report-2d", folder, alpha="0.05")).trajectory_density
    assert (density.threshold, density.threshold_interval) == (1.5, (1.0, 2.0))
    assert density.threshold_rule.startswith("alpha 0.05")
    data = json.loads((shipped_models() / "color_rgb.json").read_text())
    del data["curve"]
    (folder / "color_rgb.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"color: .* the rates are none"):
        load_models(settings("report", folder, alpha="0.05"))


def test_each_gate_may_have_a_rate_of_its_own_and_the_others_stay_as_they_ship():
    shipped = models_of("report")
    one = load_models(settings("report", alpha="location=0.05"))
    assert one.color_classes.threshold == shipped.color_classes.threshold
    assert one.location_classes.threshold_rule.startswith("alpha 0.05")
    both = load_models(settings("report", alpha="0.3, color=0.02"))
    assert both.color_classes.threshold_rule.startswith("alpha 0.02")
    assert both.location_classes.threshold_rule.startswith("alpha 0.3")


@pytest.mark.parametrize(
    ("preset", "alpha", "gates"),
    [
        ("report", "colour=0.1", "color, location"),
        ("report", "0", "color, location"),
        ("report", "color=0.1,location=2", "color, location"),
        ("report", "color", "color, location"),
        ("report-shape", "location=0.1", "color, shape"),
        ("report-2d", "nan", "color, trajectory"),
        ("default", "color=0.1", "place, back_place"),
    ],
)
def test_what_is_no_rate_or_no_gate_is_refused_with_the_gates_that_there_are(preset, alpha, gates):
    with pytest.raises(UsageError, match=rf"--alpha .*the gates of this run are: {gates}\."):
        load_models(settings(preset, alpha=alpha))


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("color_rgb", lambda d: [d.pop("threshold"), d.pop("threshold_rule")], "no threshold"),
        ("color_rgb", lambda d: d["classes"][0].update(name="purple"), "purple"),
        ("color_rgb", lambda d: d.update(space="hsv"), "'hsv' among rgb"),
        ("color_rgb", lambda d: d.update(classes=[]), "has no class"),
        ("color_rgb", lambda d: d.update(space="chromaticity"), "has 2 numbers"),
        ("shape", lambda d: d["classes"][0].update(name="heart"), "heart"),
        ("location_report", lambda d: d.update(space="rgb"), "'rgb' among right_up_m"),
    ],
)
def test_a_gate_that_does_not_fit_its_stage_is_refused(tmp_path, name, change, words):
    data = json.loads((shipped_models() / f"{name}.json").read_text())
    change(data)
    (tmp_path / f"{name}.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=rf"model of .*{words}.*Learn it again"):
        load_models(settings("report-shape" if name == "shape" else "report", tmp_path))


def with_curve(folder, *names):
    """Model files that ship, with operating points, in a folder."""
    for name in names:
        data = json.loads((shipped_models() / name).read_text())
        data["curve"] = [[0.01, 0.5, 1.5, 1.0, 2.0], [0.1, 0.9, -0.5, -1.0, 0.0]]
        (folder / name).write_text(json.dumps(data))
    return folder


def test_a_false_alarm_rate_moves_the_decision_of_the_default_preset_not_the_confidence(
    tmp_path, shipped
):
    folder = with_curve(tmp_path, "place.json", "back_place.json")
    read = load_models(settings(folder=folder))
    for alpha, decision in ((0.05, 1.5), (0.2, -0.5)):
        traded = load_models(settings(folder=folder, alpha=str(alpha)))
        front, back = traded.landmark_classifier, traded.back_landmark_classifier
        assert (front.decision, back.decision) == (decision, decision)
        assert front.threshold == pytest.approx(shipped.landmark_classifier.threshold + decision)
        assert front.shift == shipped.landmark_classifier.shift
        assert traded.sign_confidence(0.5) == pytest.approx(1 / (1 + math.exp(-decision)))
        assert model_to_json(model_from_json(model_to_json(front))) == model_to_json(front)
        assert traded.digests()["place"] != read.digests()["place"]
    assert read.sign_confidence(0.7) == 0.7
    with pytest.raises(InputError, match=r"place: .* at most 0\.005; the rates are 0\.01, 0\.1"):
        load_models(settings(folder=folder, alpha="0.005"))


def test_digests_are_those_of_the_files_and_of_the_new_text_where_a_model_was_changed(shipped):
    one = shipped.digests()
    assert one == load_models(settings()).digests()
    assert one["front"] == digest((shipped_models() / "front.json").read_text())
    front = replace(shipped.front_scores, threshold=7.0)
    changed = replace(shipped, front_scores=front).digests()
    assert changed == one | {"front": digest(model_to_json(front))}


@pytest.mark.parametrize("name", NETWORKS)
def test_files_of_ones_own_replace_those_that_ship(tmp_path, shipped, name):
    content = (shipped_models() / name).read_bytes() + with_metadata("seed", "my own")
    (tmp_path / name).write_bytes(content)
    text = (shipped_models() / "place.json").read_text().replace("seed", "my own seed")
    (tmp_path / "place.json").write_text(text)
    models = load_models(settings(folder=tmp_path))
    own = {NETWORKS[name]: sha256(content).hexdigest(), "place": digest(text)}
    assert models.digests() == shipped.digests() | own
    assert all("my own" in models.provenances()[kind] for kind in own)


def with_metadata(key, value):
    """Bytes that a model in ONNX's format may end in: field 14 of a protocol buffer, a pair of strings."""
    pair = b"".join(
        bytes([tag, len(text)]) + text.encode() for tag, text in ((0x0A, key), (0x12, value))
    )
    return bytes([0x72, len(pair)]) + pair


@pytest.mark.parametrize("name", ["box.onnx", "face_code.onnx"])
@pytest.mark.parametrize("content", ["nothing", "network.onnx"])
def test_a_network_of_ones_own_that_is_none_of_its_kind_is_refused(tmp_path, name, content):
    other = shipped_models() / content
    (tmp_path / name).write_bytes(other.read_bytes() if other.is_file() else b"no network")
    with pytest.raises(InputError, match=rf"models\.folder: the ONNX file .* at {name} cannot"):
        load_models(settings(folder=tmp_path))


def test_a_file_that_ships_has_its_digest_and_another_content_is_refused(tmp_path, monkeypatch):
    from wayside.pipeline.models import model_folder

    shipped = Path(str(shipped_models()))
    expected = {f.name for f in shipped.iterdir() if f.suffix in (".json", ".onnx")}
    # `make learn` writes it: cd pipeline/models && sha256sum *.json *.onnx > SHA256SUMS
    assert shipped_digests().keys() == expected
    for name in expected:
        assert sha256((shipped / name).read_bytes()).hexdigest() == shipped_digests()[name], name
        (tmp_path / name).write_bytes((shipped / name).read_bytes())
    changed = json.loads((tmp_path / "place.json").read_text()) | {"shift": 1.0}
    (tmp_path / "place.json").write_text(json.dumps(changed))
    monkeypatch.setattr(model_folder, "shipped_models", lambda: tmp_path)
    with pytest.raises(InputError, match=r"place\.json: the file differs from the model"):
        load_models(settings())


LOCATION = shipped_models() / "location.json"
BROKEN = {
    **{
        text[:40]: ("front.json", text, "not a model file")
        for text in ("", "{}", "[1]", '{"kind": "gaussian"}', '{"kind": "fish"}', "[" * 100_000)
    },
    "deep": ("front.json", '{"kind": "score", "with_network": ' * 50_000, "not a model file"),
    "no text": ("front.json", b"\xff\xfe\x00\x81", "cannot be read"),
    "another kind": ("front.json", LOCATION.read_bytes(), "'score' bel"),
}
CHANGED = {
    "nan as threshold": ("front.json", lambda d: d.update(threshold=math.nan)),
    "words as threshold": ("back.json", lambda d: d.update(threshold="high")),
    "an interval of three": ("front.json", lambda d: d.update(threshold_interval=[0.1, 0.2, 0.3])),
    "an endless interval": ("back.json", lambda d: d.update(threshold_interval=[0.0, math.inf])),
    "a sum of one score": ("front.json", lambda d: d["with_network"].pop("own")),
    "nan in a sum": ("front.json", lambda d: d["with_network"].update(shift=math.nan)),
    "a list as sum": ("front.json", lambda d: d.update(with_network=[1, 2, 3])),
    "no threshold": ("back.json", lambda d: d.pop("threshold")),
    "evidence without a curve": ("place.json", lambda d: d["features"][0].pop("curve")),
    "a curve of nan": ("place.json", lambda d: d["features"][0]["curve"].append(math.nan)),
    "knots out of order": ("place.json", lambda d: d["features"][0]["knots"].reverse()),
    "another input": ("place.json", lambda d: d["features"][0].update(name="glitter")),
    "another of backs": ("back_place.json", lambda d: d["features"][0].update(name="glitter")),
    "another term": ("place.json", lambda d: d["features"][0].update(term="mood")),
    "a mean of another size": ("location.json", lambda d: d["classes"][0]["mean"].pop()),
    "no covariance": ("location.json", lambda d: d["classes"][0].update(covariance=[[0, 0]] * 2)),
    "nan as weight": ("outline.json", lambda d: d["weights"].update(glitter=math.nan)),
    "another weight": ("outline.json", lambda d: d["weights"].update(glitter=1.0)),
    "a share above all": ("trajectory.json", lambda d: d["weight"].__setitem__(0, 2.0)),
}


@pytest.mark.parametrize("what", [*BROKEN, *CHANGED])
def test_a_file_that_is_no_model_that_can_be_used_is_refused_with_its_name(tmp_path, what):
    name, content, words = BROKEN.get(what) or (*CHANGED[what], "")
    if callable(content):
        data = json.loads((shipped_models() / name).read_text())
        content(data)
        content = json.dumps(data)
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError, match=rf"{re.escape(name)}: .*{words}"):
        load_models(settings("report-2d" if name == "trajectory.json" else "default", tmp_path))


@pytest.mark.parametrize("name", ["location_report.json", "colour.json"])
def test_a_folder_without_a_model_that_the_preset_reads_is_refused(tmp_path, name):
    (tmp_path / name).write_text((shipped_models() / "location_report.json").read_text())
    with pytest.raises(InputError, match=r"models\.folder: .* holds no model file of this preset"):
        load_models(settings("default", tmp_path))
    with pytest.raises(InputError, match=r"models\.folder: there is no folder"):
        load_models(settings(folder=tmp_path / "none"))


def test_a_detection_network_is_read_where_it_is_named_and_its_digest_is_stated(tmp_path):
    onnx = Path(__file__).parents[1] / "stages" / "detection" / "red_cells.onnx"
    models = load_models(settings(network=str(onnx)))
    assert models.detection_network.path == str(onnx)
    assert models.digests()["network"] == sha256(onnx.read_bytes()).hexdigest()
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    for name in (broken, tmp_path / "missing.onnx"):
        with pytest.raises(InputError, match=r"models\.network"):
            load_models(settings(network=str(name)))


def test_the_detection_network_that_ships_is_used_by_preset_default_alone(shipped):
    assert Path(shipped.detection_network.path).parent == Path(str(shipped_models()))
    assert load_models(settings("report", network="network.onnx")).detection_network is None


TEXT = (
    "rendered drives learn_alley (60 images, 197 faces), learn_town (9 images, 1 faces); seed 1; "
    "rendered/tune_hill: 22 images, own; us_clip: 42 images, MIT (upstream); town, held out: 5 of 9"
)


def test_a_log_was_learned_from_if_it_is_listed_with_its_images_under_its_whole_name():
    for log in ("learn_alley", "learn_town", "tune_hill", "us_clip"):
        assert learned_from(log, {"box": TEXT, "place": "seed 1"}) == ("box",)
    for log in ("alley", "learn", "hill", "us", "clip", "town", "seed", "us.clip"):
        assert learned_from(log, {"box": TEXT}) == ()


@given(st.binary(max_size=200))
def test_a_file_that_is_no_onnx_has_no_metadata_or_readable_one(content):
    assert all(isinstance(text, str) for text in onnx_metadata(content).values())
