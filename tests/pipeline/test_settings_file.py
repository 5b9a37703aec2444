"""Layered settings: which layer wins, what is refused and how, and the way to TOML and back."""

import tomllib
from dataclasses import asdict, fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.files.settings_file import format_settings, load_settings, settings_digest
from wayside.schemas.errors import UsageError
from wayside.schemas.settings import REPORT, Settings


def toml(tmp_path, text):
    path = tmp_path / "my.toml"
    path.write_text(text, "utf-8")
    return path


def test_without_layers_every_value_is_the_default_and_says_so():
    settings, origins = load_settings()
    assert settings == Settings()
    assert set(origins.values()) == {"default"}
    assert "segment.clusters" in origins


def test_the_report_preset_sets_its_own_values_and_nothing_else():
    with pytest.raises(UsageError, match="did you mean report"):
        load_settings("reports")
    settings, origins = load_settings("report")
    own = {f"{group}.{name}" for group, values in REPORT.items() for name in values}
    assert {name for name, origin in origins.items() if origin == "preset report"} == own
    for group, values in REPORT.items():
        assert asdict(settings)[group].items() >= values.items()


@pytest.mark.parametrize("name", ["report-shape", "report-2d"])
def test_an_earlier_generation_of_the_report_differs_in_its_gate_alone(name):
    last, own = load_settings("report")[0], load_settings(name)[0]
    gates = own.report.shape, own.report.trajectory != "off", own.locate.gate
    assert gates == (name == "report-shape", name == "report-2d", False)
    assert replace(own, report=last.report, locate=last.locate) == last


def test_later_layers_win_over_earlier_ones(tmp_path):
    file = toml(tmp_path, "[gate]\nsmallest_px = 60\nlargest_px = 30000\n[segment]\nclusters = 4\n")
    options = {"segment.clusters": 6, "run.workers": None}
    assigned = ["segment.clusters=5", "gate.smallest_px=70"]
    settings, origins = load_settings("report", file, assigned, options)
    assert (settings.segment.clusters, origins["segment.clusters"]) == (6, "option")
    assert (settings.gate.smallest_px, origins["gate.smallest_px"]) == (70, "--set")
    assert (settings.gate.largest_px, origins["gate.largest_px"]) == (30000, "my.toml")
    assert (settings.run.workers, origins["run.workers"]) == (2, "default")


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("balance.on", "no", False),
        ("locate.gate", "False", False),
        ("read.from_s", "30s", 30.0),
        ("read.thin_m", "5", 5.0),
        ("read.spacing_m", "7.6 m", 7.6),
        ("read.spacing_m", "25ft", 7.62),
        ("motion.antenna_ahead_m", "-5ft", -1.524),  # behind the camera
        ("motion.antenna_right_m", "20cm", 0.2),
        ("gate.largest_px", "20_000px", 20_000),
        ("read.camera", "/front=left", "/front=left"),
        ("models.detector_format", "yolov5", "yolov5"),
    ],
)
def test_assignments_and_options_take_the_type_of_the_setting(name, text, value):
    group, leaf = name.split(".")
    settings, _ = load_settings(assignments=[f"{name}={text}"])
    found = getattr(getattr(settings, group), leaf)
    assert found == value
    assert type(found) is type(value)
    assert load_settings(options={name: text})[0] == settings


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("segment.cluster=8", "did you mean segment.clusters"),
        ("clusters=8", "did you mean segment.clusters"),
        ("gate.workers=8", "did you mean"),
        ("zzz=1", "wayside settings"),
        ("segment.clusters", "group.name=value"),
        ("=8", "group.name=value"),
        ("segment.clusters=1", "2 to 256"),
        ("segment.clusters=257", "2 to 256"),
        ("segment.clusters=8.5", "a whole number"),
        ("read.every=0", "at least 1"),
        ("read.from_s=-1", "at least 0"),
        ("locate.confidence=nan", "0 to 1"),
        ("read.thin_m=inf", "at least 0"),
        ("read.thin_m=3 furlongs", "(m)"),
        ("balance.on=maybe", "true or false"),
        ("report.trajectory=magic", "off or image or compensated"),
        ("gate.largest_px=10", "no region could pass"),
        ("track.fewest_views=15", "no sign could be reported"),
        ("motion.antenna_ahead_m=-400ft", "must be a number"),
        ("report.shape=true", "report-2d"),
        ("models.detector=a.onnx, models.detections=b.parquet", "Give one"),
        ("models.classes=a.toml", "give --detector or --detections"),
        ("models.detector=a.onnx, report.on=true", "preset default"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_what_was_wanted(text, words):
    with pytest.raises(UsageError) as refusal:
        load_settings(assignments=text.split(", "))
    assert words in str(refusal.value)
    assert len(str(refusal.value).splitlines()) <= 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[segmnt]\nclusters = 8\n", "did you mean segment"),
        ("[segment]\nclustres = 8\n", "did you mean segment.clusters"),
        ("segment = 8\n", r"table \[segment\]"),
        ("[segment]\nclusters = true\n", "a whole number"),
        ("[segment]\nclusters = [8]\n", "a whole number"),
        ("[balance]\non = 1\n", "true or false"),
        ("[segment\n", "not valid TOML"),
        ("a = " + "[" * 100_000, "too deeply"),
        ("[read]\nfrom_s = 20\nuntil_s = 10\n", "until_s"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path, text, words):
    with pytest.raises(UsageError, match=words) as refusal:
        load_settings(file=toml(tmp_path, text))
    assert "my.toml" in str(refusal.value) or "until_s" in words
    with pytest.raises(UsageError, match=r"none\.toml cannot be read"):
        load_settings(file=tmp_path / "none.toml")


@given(
    clusters=st.integers(2, 16),
    thin=st.floats(0, 1e6),
    on=st.booleans(),
    topic=st.text(st.characters(exclude_categories=["Cs"])),
)
def test_what_is_written_is_read_back_the_same(tmp_path_factory, clusters, thin, on, topic):
    base = Settings()
    segment, balance = replace(base.segment, clusters=clusters), replace(base.balance, on=on)
    read = replace(base.read, thin_m=thin, camera=topic)
    settings = replace(base, segment=segment, balance=balance, read=read)
    path = tmp_path_factory.mktemp("settings") / "again.toml"
    for full in (False, True):
        path.write_text(format_settings(settings, {}, full=full), "utf-8", newline="")
        assert load_settings(file=path)[0] == settings


def test_the_full_listing_shows_every_setting_with_default_origin_and_words():
    settings, origins = load_settings(assignments=["segment.clusters=8"])
    text = format_settings(settings, origins, full=True)
    line = next(line for line in text.splitlines() if line.startswith("clusters = 8"))
    assert "colours | 16 | --set | k of pass one" in line
    assert tomllib.loads(text) == asdict(settings)
    for group in fields(settings):
        for leaf in fields(getattr(settings, group.name)):
            assert leaf.metadata["words"]
            assert leaf.metadata["origin"] in text
            name = f"{group.name}.{leaf.name}"  # its default is within its limits
            assert load_settings(options={name: leaf.default})[0] == Settings()


def test_the_digest_follows_every_value_that_can_change_a_result():
    base = Settings()
    assert settings_digest(base) == settings_digest(load_settings()[0])
    assert settings_digest(base) != settings_digest(load_settings("report")[0])
    same = set()
    for group in fields(base):
        held = getattr(base, group.name)
        name = next(
            (leaf.name for leaf in fields(held) if type(getattr(held, leaf.name)) in (int, float)),
            fields(held)[0].name,
        )
        value = getattr(held, name)
        other = f"{value}x" if isinstance(value, str) else not value if value is True else value + 1
        changed = replace(base, **{group.name: replace(held, **{name: other})})
        if settings_digest(changed) == settings_digest(base):
            same.add(group.name)
    assert same == {"run", "merge", "changes"}
