import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.learning.asked import TRAJECTORIES, faces_of_log, gather_samples
from wayside.pipeline.learning.curves import roc_curves
from wayside.pipeline.learning.gates import learn_gates, trajectory_densities
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON
from wayside.pipeline.learning.thresholds import GATE_RATES
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.models.model_folder import ModelFolder
from wayside.pipeline.roc.command import _write, format_curves, measure_roc
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.labels import LabelledImage, Labels
from wayside.schemas.landmarks import EVIDENCE_TERMS
from wayside.schemas.roc import CLASSIFIERS, CONFUSION, CURVES
from wayside.stages.classifiers import log_ratios

from ..asked import asked as samples

DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"
REPORT = load_settings("report")[0]


@pytest.fixture(scope="module")
def models():
    return load_models(REPORT)


@pytest.fixture
def asked(models):
    """Regions about the green and the blue of the model, far from all, and landmarks."""
    draw = np.random.default_rng(1)
    green, blue = (
        next(one for one in models.color_classes.classes if one.name == name)
        for name in ("green", "blue")
    )
    rgb = np.concatenate(
        [
            draw.multivariate_normal(green.mean, green.covariance / 4, 40),
            draw.multivariate_normal(blue.mean, blue.covariance / 4, 40),
            draw.uniform(0, 255, (200, 3)),
            [[0.0, 0.0, 0.0]],
        ]
    )
    colors = samples(
        [ON] * 80 + [OFF] * 200 + [NEITHER],
        rgb,
        kind=["green"] * 40 + ["blue"] * 40 + [""] * 201,
        named=["green"] * 79 + [""] + ["blue"] * 10 + [""] * 191,
    )
    places = np.concatenate([draw.normal((7, 0.5), 0.5, (30, 2)), draw.uniform(-30, 30, (90, 2))])
    located = samples([ON] * 30 + [OFF] * 90, places, "location", "right_up_m")
    return {"color": colors, "location": located}


def test_a_measurement_is_written_as_tables_pictures_and_a_recording(tmp_path, asked, models):
    for name in ("roc", "same"):
        _write(tmp_path / name, asked, list(roc_curves(asked, REPORT, models)))
    for table in (CURVES, CLASSIFIERS, CONFUSION):
        assert len({(tmp_path / name / table.file).read_bytes() for name in ("roc", "same")}) == 1
        read = pq.read_table(tmp_path / "roc" / table.file)
        assert read.schema.equals(table.schema, check_metadata=True)
        assert len(read)
    rows = pq.read_table(tmp_path / "roc" / CLASSIFIERS.file).to_pylist()
    by_class = {(row["classifier"], row["class"]): row for row in rows}
    green = by_class["color", "green"]
    assert (green["positives"], green["negatives"]) == (40, 200)
    assert green["area_low"] <= green["area"] <= green["area_high"]
    accepted = (
        log_ratios(asked["color"].values, models.color_classes)
        >= by_class["color", "all"]["threshold"]
    )
    assert green["tpr"] == np.mean(accepted[:40, 2])
    assert green["fpr"] == pytest.approx(np.mean(accepted[80:280, 2]))
    assert by_class["color", "all"]["fpr"] == pytest.approx(accepted[80:280].any(axis=1).mean())
    assert (green["resampled"], green["groups"]) == ("drive", 4)
    assert by_class["color", "white"]["area"] is None  # no white sign
    assert cv2.imread(str(tmp_path / "roc" / "roc_color.png")).std() > 5
    assert (tmp_path / "roc" / "roc.rrd").stat().st_size > 1000
    (tmp_path / "roc" / "roc_mine.png").write_bytes(b"of the user")
    rest = {name: samples for name, samples in asked.items() if name != "color"}
    _write(tmp_path / "roc", rest, list(roc_curves(rest, REPORT, models)))
    assert not (tmp_path / "roc" / "roc_color.png").exists()
    assert (tmp_path / "roc" / "roc_mine.png").exists()


def test_the_sum_of_evidence_and_each_term_have_a_curve_but_no_term_a_threshold(tmp_path):
    used = load_models(load_settings()[0])
    draw = np.random.default_rng(2)
    ratios = np.concatenate([draw.normal(k, 1, (60, len(EVIDENCE_TERMS))) for k in (1, -1)])
    values = np.column_stack([ratios.sum(axis=1), ratios])
    asked = {"landmark": samples([ON] * 60 + [OFF] * 60, values, "landmark", "log_odds")}
    curves = list(roc_curves(asked, load_settings()[0], used))
    _write(tmp_path / "roc", asked, curves)
    rows = {
        row["class"]: row for row in pq.read_table(tmp_path / "roc" / CLASSIFIERS.file).to_pylist()
    }
    assert rows.keys() == {"all", *EVIDENCE_TERMS}
    assert rows["all"]["tpr"] == np.mean(values[:60, 0] >= used.landmark_classifier.threshold)
    assert all(rows["all"]["area"] > rows[term]["area"] for term in EVIDENCE_TERMS)
    assert all(rows[term]["threshold"] is rows[term]["tpr"] is None for term in EVIDENCE_TERMS)
    assert "| landmark | size | 60 | 60 |" in format_curves(curves)


def test_the_confusion_counts_what_the_run_decided_and_leaves_out_what_is_neither(asked):
    assert asked["color"].confusion() == {
        ("blue", "green"): 39,
        ("blue", "refused"): 1,
        ("green", "green"): 40,
        ("none", "blue"): 10,
        ("none", "refused"): 190,
    }


def test_gates_are_learned_with_their_rule_and_what_they_rest_on(asked, models):
    learned = learn_gates(asked | {"panel_size": asked["location"]}, models)
    (right,) = learned["location_report.json"].classes
    assert right.mean == pytest.approx([7, 0.5], abs=0.5)
    assert "d0 (8 signs, 22 others)" in learned["location_report.json"].provenance
    ratios = log_ratios(asked["location"].values, learned["panel_size.json"])
    assert ratios[:30].min() > 0 > np.median(ratios[30:])
    color = learned["color_rgb.json"]
    assert color.classes[2].mean.tolist() == models.color_classes.classes[2].mean.tolist()
    assert sum(one.count for one in color.background) == 200
    for name, gate in (("color", color), ("location", learned["location_report.json"])):
        assert gate.threshold_rule.startswith(f"alpha {GATE_RATES[name]:g}")
    kansas, places = learned["report-kansas.json"], asked["location"]
    radius = np.linalg.norm(places.values - kansas.classes[0].mean, axis=1)
    inside = log_ratios(places.values, kansas)[:, 0] >= kansas.threshold
    assert radius[inside].max() < radius[~inside].min()
    assert 0 < inside[places.label == OFF].mean() <= GATE_RATES["location"]
    few = {"location": places.select(np.arange(12, 120))}
    with pytest.raises(InputError, match="20 landmarks of signs"):
        learn_gates(few, models)


def test_another_s_files_are_not_replaced(tmp_path, models):
    (tmp_path / "roc.parquet").write_text("mine")
    with pytest.raises(OutputError, match="not an earlier measurement"):
        measure_roc([], [], tmp_path, REPORT, models, print)
    assert (tmp_path / "roc.parquet").read_text() == "mine"


def test_labels_of_another_log_are_refused_with_what_to_do():
    other = Labels((), (LabelledImage(log="other", frame=0),))
    with pytest.raises(InputError, match="no label belongs to its images"):
        faces_of_log(DEMO, other, REPORT.read)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["report-2d", "report", "default"])
def test_a_drive_is_asked_about_by_every_classifier_of_the_preset(preset):
    settings = load_settings(preset, None, ["read.until_s=3"])[0]
    faces = faces_of_log(DEMO, read_labels(DEMO.with_suffix(".truth.json")), settings.read)
    used = load_models(settings)
    if preset == "report":
        # the same stage refuses sizes, but places first
        used = replace(used, location_classes=replace(used.location_classes, threshold=np.inf))
    densities = trajectory_densities(ModelFolder()) if preset == "report" else ()
    found = gather_samples(DEMO, faces, settings, used, undecided=densities)
    wanted = {
        "report-2d": {"size", "color", "trajectory"},
        "report": {"size", "color", "location", *TRAJECTORIES.values()},
        "default": {"detector", "landmark", "confidence"},
    }
    assert wanted[preset] == found.keys()
    for name in TRAJECTORIES.values() if preset == "report" else ():  # those that decide nothing
        assert (found[name].box == found["location"].box).all()
        assert 0 < found[name].accepted.mean() < 1
    for own in found.values():
        assert (np.diff(own.frame) >= 0).all()
        assert set(own.drive.tolist()) == {"demo"}
    if preset != "default":
        size, color = found["size"], found["color"]
        assert size.count[size.accepted].sum() == len(color)
        assert {"green", "yellow"} & set(color.kind[color.label == ON].tolist())
    else:
        truth = json.loads(DEMO.with_suffix(".truth.json").read_text())
        assert (found["confidence"].label == ON).sum() <= len(truth["signs"])
        assert (found["confidence"].label == ON).any()
        tested = {
            one.name for one in roc_curves(found, settings, used) if one.classifier == "landmark"
        }
        assert tested == {"all", *EVIDENCE_TERMS}
        sums, *ratios = found["landmark"].values.T
        shift = used.landmark_classifier.shift
        assert sums == pytest.approx(shift + np.sum(ratios, axis=0), abs=1e-6)
