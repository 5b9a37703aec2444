"""Positions at the times of images, and those that no vehicle can have been at."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from wayside.pipeline.reading.contents import FixContent, PoseContent
from wayside.pipeline.reading.series import (
    Samples,
    Series,
    continuous_longitudes,
    interpolate,
    metres,
    possible,
)
from wayside.schemas.frame import Fix

SECOND = 10**9
quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.6)
    .map(lambda q: tuple(v / math.hypot(*q) for v in q))
)


def samples(times, positions, rotations=None, sigma=None):
    n = len(times)
    value = np.zeros((n, 10))
    value[:, :3] = np.reshape(positions, (n, -1))
    value[:, 3:7] = [0, 0, 0, 1] if rotations is None else rotations
    value[:, 7:] = np.nan if sigma is None else sigma
    return Samples.sorted(np.array(times, np.int64), value)


@given(quaternions, quaternions, st.floats(0, 1))
def test_rotations_between_two_samples_are_those_of_scipy(first, second, part):
    expected = Slerp([0, 1], Rotation.from_quat([first, second]))(part)
    series = samples([0, SECOND], np.zeros((2, 3)), [first, second])
    found = interpolate(series, np.array([round(part * SECOND)]))
    halfway = abs(np.dot(first, second)) < 1e-3  # either way is short
    assert halfway or (Rotation.from_quat(found.value[0, 3:7]).inv() * expected).magnitude() < 1e-6


@given(quaternions, st.floats(0.6, 1.9))
def test_quaternions_of_any_length_are_taken_as_rotations(q, length):
    positions = Series()
    positions.add(5, PoseContent(None, "", "", tuple(v * length for v in q), (1.0, 2.0, 3.0)))
    assert positions.values()[0, 3:7] == pytest.approx(q, abs=1e-12)


@given(st.lists(st.tuples(st.integers(0, 1000), st.floats(-9, 9)), min_size=1, max_size=30))
def test_samples_in_any_order_are_sorted_and_the_last_of_a_time_wins(given_samples):
    times, values = zip(*given_samples, strict=True)
    series = samples(times, np.repeat(values, 3))
    expected = dict(given_samples)
    assert series.time_ns.tolist() == sorted(expected)
    assert series.value[:, 0].tolist() == [expected[t] for t in series.time_ns.tolist()]


@given(
    st.lists(st.integers(0, 10**9), min_size=2, max_size=20, unique=True),
    st.lists(st.integers(0, 10**9), min_size=1, max_size=9),
)
def test_positions_within_the_samples_are_those_of_numpy(times, asked):
    series = samples(times, np.repeat(np.array(times, float), 3) * 3)
    found = interpolate(series, np.array(asked))
    inside = (np.array(asked) >= min(times)) & (np.array(asked) <= max(times))
    assert found.known[inside].all()
    expected = np.interp(asked, sorted(times), 3.0 * np.sort(times))
    assert found.value[inside, 0] == pytest.approx(expected[inside], rel=1e-9, abs=1e-6)


def test_nothing_is_carried_far_beyond_the_samples_nor_across_a_silence():
    found = interpolate(
        samples([0, SECOND // 10, 7 * SECOND], np.repeat([0.0, 1.0, 9.0], 3)),
        np.array([3 * SECOND // 20, -SECOND // 20, 3 * SECOND, 7 * SECOND, 8 * SECOND]),
    )
    assert found.known.tolist() == [False, True, False, True, False]
    assert found.value[1, 0] == pytest.approx(-0.5)
    assert found.span_s[3] == 0


def test_a_single_sample_holds_at_its_own_time_only():
    found = interpolate(samples([5], [1.0, 2.0, 3.0]), np.array([5, 6]))
    assert found.known.tolist() == [True, False]
    assert found.value[0, :3].tolist() == [1, 2, 3]


def test_sigmas_are_those_of_the_nearer_sample_and_spans_the_time_between_both():
    series = samples([0, SECOND], np.zeros((2, 3)), sigma=[[0.1, 0.01, 0], [0.3, 0.03, 0]])
    found = interpolate(series, np.array([SECOND // 4, 3 * SECOND // 4, SECOND]))
    assert found.value[:, 7].tolist() == [0.1, 0.3, 0.3]
    assert found.span_s.tolist() == [1, 1, 0]


def test_fixes_are_interpolated_the_short_way_around_the_earth():
    positions = Series()
    for k, longitude in enumerate((179.9, -179.9)):
        positions.add(k * SECOND, FixContent(None, Fix(10.0 + 0.2 * k, longitude, 8.0 * k, None)))
    series = Samples.sorted(np.array([0, SECOND]), positions.values())
    found = interpolate(continuous_longitudes(series), np.array([3 * SECOND // 4]))
    assert found.value[0, [0, 2]] == pytest.approx((10.15, 6.0))
    assert abs((found.value[0, 1] + 180) % 360 - 180) == pytest.approx(179.95)
    way = np.diff(metres(continuous_longitudes(series).value[:, :3]), axis=0)
    assert np.linalg.norm(way) < 40_000


def drive(count=40, speed=20.0, noise=0.0, seed=1):
    time = np.arange(count) * SECOND // 4
    east = speed * time * 1e-9
    path = np.stack([east, 30 * np.sin(east / 80), np.full(count, 1.5)], axis=1)
    return time, path + np.random.default_rng(seed).normal(0, noise, path.shape)


@pytest.mark.parametrize("noise", [0.0, 0.05, 1.5])
def test_positions_of_a_vehicle_are_all_possible(noise):
    for speed in (0.0, 20.0, 60.0):
        assert possible(*drive(speed=speed, noise=noise)).all()


@pytest.mark.parametrize("rows", [[7], [21, 30]])
def test_positions_beside_the_path_of_their_neighbours_are_not_possible(rows):
    time, path = drive(noise=0.01)
    path[rows] += (2.0, 6.0, 0.0)
    assert np.flatnonzero(~possible(time, path)).tolist() == rows


def test_a_series_that_only_jumps_is_judged_in_bounded_time():
    rng = np.random.default_rng(5)
    count = 20_000
    kept = possible(np.arange(count) * SECOND // 100, rng.normal(0, 1e6, (count, 3)))
    assert 0 < kept.sum() < 100
