"""The acceptance program: its tables, its floor, and a run that fails."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from wayside.pipeline.evaluation import figures
from wayside.pipeline.models.model_files import onnx_metadata

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def accept(load):
    return load("accept")


def found(along):
    sign = {"sign_id": "d-0001", "color": "red", "shape": "circle", "panel_height_m": None}
    sign |= {"panel_width_m": 0.66, "bottom_m": 1.5}
    panel = {"id": 1, "color": "red", "shape": "octagon", "width_m": 0.6, "height_m": 0.6}
    return figures.Match(sign, panel | {"bottom_m": 1.5}, (0.0, 0.0, along))


FALSE = {"sign_id": "d-0002", "best_frame": 3, "cause": "unknown"}
MISSED = {"id": 7}
GOOD = figures.RenderedEvaluation(2, (found(0.1), found(-0.3)), 2, backs=figures.Backs(3, 2, 5))
POOR = figures.RenderedEvaluation(2, (found(0.8),), 1, (FALSE,), (MISSED,))


@pytest.fixture
def outcome(accept):
    """What came of a drive of a name."""
    return lambda name, evaluation, *more: accept.Outcome(
        accept.BenchmarkDrive(name, Path(), Path(), ""), evaluation, *more
    )


def test_the_table_has_a_line_a_drive_and_one_for_all(accept, outcome):
    outcomes = [outcome("good", GOOD), outcome("poor", POOR), outcome("lost", None)]
    lines = accept.rendered_table(outcomes)
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| good", "| poor", "| **together**"]
    assert lines[2] == (
        "| good | 2 | 2 | 1.000 | 1.000 | 0 | 0 | 0.20 / 0.29 | 0.00 / 0.00 | 0.00 / 0.00 | 10.0 / 10.0 | - | 100 % "
        "| 0 % | 2 of 3 / 5 |"
    )
    assert {line.count("|") for line in lines} == {16}


def test_a_drive_is_run_once_more_by_models_learned_without_it(accept, monkeypatch, tmp_path):
    monkeypatch.setattr(accept, "WITHOUT", tmp_path)
    (tmp_path / "city").mkdir()
    drives = [accept.BenchmarkDrive(name, Path(), Path(), "") for name in ("road", "city")]
    asked = {p: list(accept.with_models_without(drives, p)) for p in ("default", "report")}
    assert [one.name for one in asked["default"]] == ["road", "city", "city, models without it"]
    assert [one.models for one in asked["default"]] == [None, None, tmp_path / "city"]
    assert asked["report"] == drives


def test_models_without_a_drive_say_that_they_have_not_learned_from_it():
    folders = [p for p in (ROOT / "benchmarks" / "models_without").iterdir() if p.is_dir()]
    assert {folder.name for folder in folders} == {"ca_city_garmin", "us_freeway_yellow_left"}
    for folder in folders:
        said = {
            path.name: str(onnx_metadata(path.read_bytes()))
            if path.suffix == ".onnx"
            else path.read_text()
            for path in folder.iterdir()
        }
        assert "place.json" in said
        assert ("network.onnx" in said) == (folder.name == "ca_city_garmin")
        assert not any(folder.name in text for text in said.values())


def test_the_line_of_a_drive_counts_duplicates_among_the_false_or_beside_them(accept):
    twice = (figures.Duplicate("d-0002", 1, "d-0001"),)
    assert accept.in_short(replace(POOR, duplicates=twice)) == (
        "recall 0.500 (1/2)  precision 0.500 (1 false, of them 1 duplicates)"
    )
    real = figures.RealEvaluation(1, ("R1",), 2, (FALSE,), (), duplicates=twice)
    assert accept.in_short(real) == (
        "recall 1.000 (1/1)  precision 0.667 (1 false, beside them 1 duplicates)"
    )


def test_a_total_below_the_floor_is_named(accept, outcome, tmp_path, monkeypatch):
    floor = tmp_path / "floor.toml"
    floor.write_text("[default]\nrecall = 0.8\nprecision = 0.7\n")
    monkeypatch.setattr(accept, "FLOOR", floor)
    outcomes = [outcome("d", GOOD), outcome("d", POOR)]
    assert list(accept.below_floor({"default": outcomes})) == [
        "default: recall 0.7500 is below the floor of 0.8"
    ]
    assert figures.together([]).recall == 1.0


def test_rendered_drives_that_models_learned_from_are_named_and_real_ones_stand_apart(
    accept, outcome
):
    real = figures.RealEvaluation(learned_by=("network",))
    outcomes = [
        outcome("clean", replace(GOOD, learned_by=())),
        outcome("seen", replace(GOOD, learned_by=("box", "place"))),
        outcome("road", real, 2),
        outcome("lost", None),
    ]
    assert accept.real(outcomes) == [("road", real, 2, ())]
    learned, lost = accept.unfit({"default": outcomes})
    assert learned == "default: box, place learned from seen"
    assert lost == "default: lost could not be evaluated"


def test_a_page_keeps_what_it_says_above_the_versions(accept, tmp_path, monkeypatch):
    monkeypatch.setattr(accept, "BENCHMARKS", tmp_path)
    (tmp_path / "page.md").write_text("Words.\n\nVersions: old.\n\n| old |\n")
    accept.write_page("page.md", {"Title": ["| new |"]})
    new = f"Words.\n\n{accept.versions()}\n\n## Title\n\n| new |\n"
    assert (tmp_path / "page.md").read_text() == new


def test_a_run_that_fails_is_told_and_not_evaluated(accept, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(accept, "RESULTS", tmp_path)
    drive = accept.BenchmarkDrive("none", tmp_path / "none.mcap", tmp_path / "none.truth.json", "")
    assert accept.evaluate_drive(drive, "default").evaluation is None
    assert "status 3" in capsys.readouterr().out


def test_every_drive_that_is_measured_has_a_specification_and_every_preset_a_floor(accept):
    floor = tomllib.loads((ROOT / "benchmarks" / "floor.toml").read_text())
    assert set(floor) == set(accept.PRESETS)
    assert {tuple(sorted(shares)) for shares in floor.values()} == {("precision", "recall")}
    for name in accept.RENDERED:
        assert not name.startswith("learn_")
        assert (ROOT / "recordings" / "drives" / "specs" / f"{name}.toml").is_file()
