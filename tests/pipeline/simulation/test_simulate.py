import json
import math
from dataclasses import replace

import numpy as np
import pytest

from wayside.pipeline.simulation.drive import SimulatedDrive, Survey
from wayside.pipeline.simulation.simulate import (
    check,
    focal_of_view,
    reaches,
    simulate,
    sweep_conclusion,
    sweep_row,
)
from wayside.schemas.errors import UsageError, WaysideError
from wayside.schemas.settings import MotionSettings

from ..results import invoke

SMALL = Survey(signs=5, seed=3)


@pytest.fixture(scope="module")
def small():
    return simulate(SMALL)


@pytest.mark.slow
def test_nearly_all_are_placed_near_the_bound_and_within_the_sigmas_as_often_as_they_should():
    """Of normal errors 68 % lie within one sigma and 95 % within two."""
    bent = {"curve_radius_m": 300, "hill_m": 6, "jitter_deg": 0.25, "mount_yaw_deg": 0.9}
    surveys = [
        Survey(signs=180, seed=11),
        Survey(signs=120, seed=12, **bent),
        Survey(signs=120, seed=13, pose_m=0.02),
        Survey(signs=120, seed=14, noise_px=0.8, lateral_m=-5.0, drop_rate=0.03, outliers=0.02),
    ]
    many = [simulate(survey) for survey in surveys]
    count = sum(len(one.error) for one in many)
    assert count >= max(500, 0.98 * sum(one.wanted for one in many))
    pulls = np.abs(np.concatenate([one.error / one.sigma for one in many]))
    for sigmas, low, high in ((1, 0.60, 0.76), (2, 0.92, 0.98)):
        share = (pulls < sigmas).mean(axis=0)
        assert (share >= low).all(), share
        assert (share <= high).all(), share
    for one in many:
        reached = np.quantile(np.abs(one.error), 0.6827, axis=0)
        least = np.median(one.bound, axis=0)
        assert (reached < 1.5 * least).all(), (reached, least)
        assert (reached > 0.7 * least).all(), (reached, least)
        assert (np.median(one.sigma, axis=0) > 0.9 * least).all()


def test_without_errors_signs_stand_where_they_are():
    none = dict.fromkeys(("noise_share", "face_share", "tie_drift_px", "tie_drift_share"), 0)
    exact = replace(SMALL, noise_px=1e-4, tie_px=1e-3, trigger_m=1e-5, **none)
    assert simulate(exact).total.max() < 0.01


def test_a_dropped_trigger_is_seen_by_the_ties():
    drive = SimulatedDrive(replace(SMALL, drop_rate=0.1, trigger_m=0.0))
    baselines = np.array([m.motion.baseline_m for m in drive.posed(MotionSettings())])[1:]
    assert baselines == pytest.approx(np.diff(drive.station), rel=0.01)
    assert (baselines > 15).any()


def test_the_mount_is_learnt_from_the_drive():
    drive = SimulatedDrive(replace(SMALL, mount_yaw_deg=2.0, mount_pitch_deg=-1.0))
    steps = [m.motion.step for m in drive.posed(MotionSettings())][1:]
    slopes = np.median([s.centre[:2] / s.centre[2] for s in steps], axis=0)
    assert np.degrees(slopes) == pytest.approx([-2.0, -1.0], abs=0.05)


def test_the_same_survey_gives_the_same_figures_and_another_seed_others(small):
    told = []
    again = simulate(SMALL, lambda done, total: told.append((done, total)))
    assert told == [(k + 1, len(told)) for k in range(len(told))]
    np.testing.assert_array_equal(small.error, again.error)
    assert not np.array_equal(small.error, simulate(replace(SMALL, seed=4)).error)


def test_more_noise_and_farther_signs_are_worse(small):
    noisy, far = (
        simulate(replace(SMALL, **one)) for one in ({"noise_px": 1.5}, {"range_min_m": 30.0})
    )
    for worse in (noisy, far):
        assert np.median(worse.bound[:, 0]) > 1.5 * np.median(small.bound[:, 0])
        assert np.median(worse.sigma[:, 0]) > np.median(small.sigma[:, 0])
    assert far.nearest.min() > 30


def test_a_target_counts_signs_that_were_not_found(small):
    assert reaches(small, 1.0)
    assert not reaches(replace(small, wanted=2 * small.wanted), 1.0)
    assert not reaches(small, 0.001)
    assert sweep_row(small, 1.0).endswith("reached")
    assert "widest" in sweep_conclusion([small], 1.0)
    assert "none of these" in sweep_conclusion([small], 0.001)


@pytest.mark.parametrize(
    "wrong",
    [
        *({"spacing_m": 0.0}, {"focal_px": 5.0}, {"curve_radius_m": 3.0}, {"drop_rate": 0.9}),
        *({"signs": 0}, {"mount_yaw_deg": 40.0}, {"lateral_m": 0.0}, {"seed": -1}),
        *({"jitter_deg": -1.0}, {"jitter_deg": math.nan}, {"mount_pitch_deg": math.nan}),
        *({"pose_m": 0.0}, {"trigger_m": 50.0}),
    ],
)
def test_what_cannot_be_driven_is_refused_by_its_option(wrong):
    with pytest.raises(UsageError, match="--"):
        check(replace(SMALL, **wrong))
    with pytest.raises(UsageError, match="--hfov"):
        focal_of_view(180.0, 1600)


def test_signs_that_no_image_shows_thrice_are_an_error_with_advice():
    with pytest.raises(WaysideError, match="shorten --spacing"):
        simulate(replace(SMALL, spacing_m=90.0, panel_m=0.3))


def test_the_command_prints_a_table_and_writes_json(tmp_path):
    file = tmp_path / "plan.json"
    options = ["--spacing", "26.4ft", "--hfov", "60", "--signs", "5", "--json", file]
    said = invoke("simulate", *options)
    assert "along" in said
    assert "bound" in said
    (survey,) = json.loads(file.read_text())["surveys"]
    assert survey["survey"]["spacing_m"] == pytest.approx(8.04672)
    assert survey["survey"]["focal_px"] == pytest.approx(1385.6, abs=0.1)
    assert survey["error"]["along"]["sigma_m"] > 0
    assert "spacing given; focal length 1386 px (60 degrees)" in said
