import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from wayside.pipeline.reading.contents import PoseContent
from wayside.pipeline.reading.poses import to_pose
from wayside.pipeline.reading.series import (
    MOST_SAMPLES,
    TimeSeries,
    blend_fixes,
    blend_poses,
    slerp,
)
from wayside.schemas.frame import Fix
from wayside.schemas.settings import ReadSettings

quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.6)
    .map(lambda q: tuple(v / math.hypot(*q) for v in q))
)

SETTINGS = ReadSettings()


def blend(a, b, fraction):
    return a + (b - a) * fraction


@given(quaternions, quaternions, st.floats(0, 1))
def test_slerp_agrees_with_scipy(first, second, fraction):
    expected = Slerp([0, 1], Rotation.from_quat([first, second]))(fraction)
    found = Rotation.from_quat(slerp(first, second, fraction))
    halfway = (
        abs(sum(a * b for a, b in zip(first, second, strict=True))) < 1e-3
    )  # either way is short
    assert halfway or (found.inv() * expected).magnitude() < 1e-6


@given(quaternions, st.floats(0.6, 1.9))
def test_a_quaternion_of_any_length_gives_the_rotation_matrix_of_scipy(q, length):
    content = PoseContent(None, "", "", tuple(v * length for v in q), (1, 2, 3))
    assert to_pose(content).rotation == pytest.approx(Rotation.from_quat(q).as_matrix(), abs=1e-12)


@given(st.lists(st.tuples(st.integers(0, 1000), st.floats(-9, 9)), min_size=1, max_size=30))
def test_samples_in_any_order_end_up_sorted_and_the_latest_of_a_time_wins(samples):
    series = TimeSeries()
    for time, value in samples:
        series.add(time, value)
    expected = dict(samples)
    assert series.times == sorted(expected)
    assert series.values == [expected[t] for t in series.times]


@given(st.lists(st.integers(0, 10**9), min_size=2, max_size=20, unique=True), st.integers(0, 10**9))
def test_values_within_the_samples_are_those_of_numpy(times, time):
    series = TimeSeries()
    for t in times:
        series.add(t, t * 3.0)
    found = series.at(time, blend, SETTINGS)
    if min(times) <= time <= max(times):
        assert found == pytest.approx(time * 3.0, rel=1e-9, abs=1e-6)


def test_nothing_is_carried_far_beyond_the_samples():
    series = TimeSeries()
    series.add(0, 0.0)
    series.add(10**8, 1.0)
    assert series.at(15 * 10**7, blend, SETTINGS) == pytest.approx(1.5)
    assert series.at(-5 * 10**7, blend, SETTINGS) == pytest.approx(-0.5)
    assert series.at(3 * 10**8, blend, SETTINGS) is None


def test_a_single_sample_holds_at_its_own_time_only():
    series = TimeSeries()
    series.add(5, 1.0)
    assert series.at(5, blend, SETTINGS) == 1.0
    assert series.at(6, blend, SETTINGS) is None


def test_the_latest_sample_is_that_at_or_before_a_time_else_the_first():
    series = TimeSeries()
    assert series.latest(3) is None
    for time in (10, 20):
        series.add(time, time)
    assert [series.latest(t) for t in (5, 10, 15, 20, 25)] == [10, 10, 10, 20, 20]


def test_a_series_holds_a_bounded_number_of_samples():
    series = TimeSeries()
    for time in range(5 * MOST_SAMPLES):
        series.add(time, 0)
    assert MOST_SAMPLES <= len(series.times) <= 2 * MOST_SAMPLES


def test_sigmas_are_those_of_the_nearer_pose():
    first = PoseContent(None, "w", "c", (0, 0, 0, 1), (0, 0, 0), 0.1, 0.01)
    second = PoseContent(None, "w", "c", (0, 0, 0, 1), (4, 0, 0), 0.3, 0.03)
    found = blend_poses(first, second, 0.75)
    assert found.translation == (3, 0, 0)
    assert (found.sigma_m, found.sigma_rad) == (0.3, 0.03)


def test_fixes_are_blended_the_short_way_around_the_earth():
    first, second = Fix(10.0, 179.9, 0.0, None), Fix(10.2, -179.9, 8.0, None)
    found = blend_fixes(first, second, 0.75)
    assert (found.latitude_deg, found.altitude_m) == pytest.approx((10.15, 6.0))
    assert found.longitude_deg == pytest.approx(-179.95)
    assert np.isclose(blend_fixes(first, second, 0.25).longitude_deg, 179.95)


def test_the_span_is_the_time_between_the_samples_round_a_moment():
    series: TimeSeries[float] = TimeSeries()
    assert series.span_ns(5) == 0
    series.add(10, 1.0)
    assert series.span_ns(5) == 0
    series.add(30, 2.0)
    series.add(70, 3.0)
    assert [series.span_ns(t) for t in (5, 10, 20, 30, 31, 90)] == [20, 0, 20, 0, 40, 40]
