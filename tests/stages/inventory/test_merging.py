"""Sightings of several drives to panels: offsets, groups, faces, error bars."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from wayside.schemas.settings.merging import MergeSettings
from wayside.stages.inventory import match_moved, merge_sightings
from wayside.stages.inventory.association import (
    DENSITY,
    MOST_CHANGED,
    TAIL_FREEDOM,
    miss_log_ratio,
    place_log_ratio,
)
from wayside.stages.inventory.grouping import combine, face_runs
from wayside.stages.inventory.offsets import CORRELATION_S, relative_variance, solve_offsets

from . import made_sightings
from .made_sightings import road

SETTINGS = MergeSettings()
DAY_NS = 86_400 * 10**9


def make_sightings(truth, offsets, *, noise_m=0.0, common_m=1.0, apart_ns=DAY_NS, seed=0):
    """Every drive sees every panel at the same times along the road, off by an offset of its own."""
    n, drives = len(truth), len(offsets)
    noise = np.random.default_rng(seed).normal(0, noise_m, (n * drives, 3))
    place = np.tile(truth, (drives, 1))
    time = np.repeat(np.arange(drives), n) * apart_ns + (place[:, 0] / 25 * 1e9).astype(np.int64)
    position = place + np.repeat(offsets, n, axis=0) + noise
    return made_sightings.make_sightings(
        position, drives, own_m=0.05, common_m=common_m, face=np.arange(n), time_ns=time
    )


def test_offsets_are_those_of_the_dense_least_squares():
    sightings = make_sightings(road(6), [[0.4, 0, 0], [-0.3, 0.2, 0.1]], noise_m=0.02)
    found, _ = solve_offsets(sightings, SETTINGS)
    n = 12
    lag_s = np.abs(np.subtract.outer(sightings.time_ns, sightings.time_ns)) * 1e-9
    same = np.equal.outer(sightings.drive, sightings.drive)
    prior = np.where(same, np.exp(-lag_s / CORRELATION_S), 0.0)
    design = np.zeros((6, n))
    design[np.arange(6), np.arange(6)], design[np.arange(6), np.arange(6) + 6] = 1, -1
    measured = sightings.position[:6] - sightings.position[6:]
    for axis in range(3):
        weight = np.ones(6)
        for _ in range(20):  # the robust weights are those of the residuals of the round before
            noise = np.diag(2 * 0.05**2 / weight)
            gain = prior @ design.T @ np.linalg.inv(design @ prior @ design.T + noise)
            expected = gain @ measured
            left = measured - design @ expected
            weight = 1 / np.square(1 + np.square(left).sum(axis=1) / (2 * 0.05**2) / 21.1)
        assert found[:, axis] == pytest.approx(expected[:, axis], abs=2e-3)


def test_equal_signs_nearer_than_the_error_of_the_fixes_are_told_apart_by_the_row_they_stand_in():
    chevrons = np.array([100, 6.0, 2.2]) + np.outer(np.arange(12), [6.0, 0, 0])
    mixed = np.concatenate([road(4), chevrons, road(30)[20:]])
    sightings = make_sightings(mixed, [[1.6, 0.2, 0], [-1.5, 0, 0.3]], noise_m=0.03)
    alike = (sightings.row >= 4) & (sightings.row < 16)
    color, shape = np.where(alike, 1, sightings.color), np.where(alike, 0, sightings.shape)
    merged = merge_sightings(replace(sightings, color=color, shape=shape), SETTINGS)
    assert (merged.panel[: len(mixed)] == merged.panel[len(mixed) :]).all()


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(2, 5), st.floats(0.0, 3.0))
def test_every_sighting_is_of_one_panel_and_no_panel_has_two_of_a_drive(seed, drives, spread_m):
    rng = np.random.default_rng(seed)
    truth, offsets = road(8) + rng.normal(0, 1.0, (8, 3)), rng.normal(0, spread_m, (drives, 3))
    sightings = make_sightings(truth, offsets, noise_m=0.1, seed=seed)
    merged = merge_sightings(sightings, SETTINGS)
    seen = np.column_stack([merged.panel, sightings.drive])
    assert len(np.unique(seen, axis=0)) == len(seen) == len(sightings)
    assert sorted(set(merged.panel.tolist())) == list(range(len(merged.position)))
    again = merge_sightings(sightings, SETTINGS)
    assert (again.panel == merged.panel).all()
    assert (again.position == merged.position).all()


def test_a_panel_is_the_mean_by_covariance_with_the_error_bar_of_the_mean_of_common_errors():
    for drives in (1, 4, 16):
        sightings = make_sightings(road(1), [[0, 0, 0]] * drives, common_m=0.9)
        _, covariance = combine(sightings, sightings.position, np.zeros(drives, np.int64))
        assert np.sqrt(covariance[0, 0, 0]) == pytest.approx(np.hypot(0.9, 0.05) / drives**0.5)
        assert covariance[0, 0, 0] >= 0.9**2 / drives
    two = make_sightings(road(1), [[0, 0, 0], [0.3, 0, 0]])
    two.covariance[1] /= 4
    position, _ = combine(two, two.position, np.zeros(2, np.int64))
    assert position[0, 0] == pytest.approx(0.8 * 0.3)


def test_a_pair_does_not_vouch_for_itself():
    sightings = make_sightings(road(1), [[0, 0, 0], [0.1, 0, 0]])
    _, known = solve_offsets(sightings, SETTINGS)
    assert known.tolist() == [[0, 1]]
    alone = relative_variance(sightings, known, known)
    assert alone[0].tolist() == pytest.approx([2.0, 2.0])  # both drives' own square metre
    more = make_sightings(road(3), [[0, 0, 0], [0.1, 0, 0]])
    _, known = solve_offsets(more, SETTINGS)
    assert (relative_variance(more, known, known) < 0.1).all()


@pytest.mark.parametrize(
    ("read", "days", "panels"),
    [((1, 1, 3, 1), (0, 1, 2, 3), [0, 0, 0, 0]), ((1, 1, 3, 3), (0, 1, 366, 367), [0, 0, 1, 1])],
)
@pytest.mark.parametrize("column", ["color", "code"])
def test_a_face_read_wrong_once_is_no_other_panel_and_one_that_differs_a_year_later_is(
    column, read, days, panels
):
    sightings = make_sightings(road(1), [[0, 0, 0]] * 4)
    sightings = replace(sightings, **{column: np.array(read)}, time_ns=np.array(days) * DAY_NS)
    assert face_runs(sightings, np.zeros(4, np.int64), SETTINGS).tolist() == panels


def test_panels_back_to_back_on_one_post_are_two_on_one_support():
    sightings = make_sightings(road(20), [[0.2, 0, 0], [-0.2, 0, 0]])
    turned = np.where((sightings.row == 7) & (sightings.drive == 1), np.pi, 0.0)
    merged = merge_sightings(replace(sightings, bearing_rad=turned), SETTINGS)
    one, other = merged.panel[7], merged.panel[27]
    assert one != other
    assert merged.support[one] == merged.support[other]


@pytest.mark.parametrize(("days", "one_place"), [(1, False), (366, True)])
def test_a_face_of_another_colour_shape_and_size_takes_a_place_only_after_years(days, one_place):
    sightings = make_sightings(road(20), [[0.2, 0, 0], [-0.2, 0, 0]], apart_ns=days * DAY_NS)
    other = (sightings.row == 7) & (sightings.drive == 1)
    changed = replace(
        sightings,
        color=sightings.color + other,
        shape=sightings.shape + other,
        size_m=sightings.size_m * np.where(other, 1.3, 1.0)[:, None],
        position=sightings.position + np.outer(other, [0.5, 0, 0]),
    )
    merged = merge_sightings(changed, SETTINGS)
    before, after = merged.panel[7], merged.panel[27]
    assert before != after
    assert (merged.place[before] == merged.place[after]) == one_place


def test_the_ratio_of_places_is_the_student_density_against_that_of_neighbours():
    rng = np.random.default_rng(3)
    root = rng.normal(0, 0.2, (20, 3, 3))
    spread = root @ root.transpose(0, 2, 1) + 0.01 * np.eye(3)
    apart = rng.normal(0, 0.5, (20, 3))
    found = place_log_ratio(apart, spread)
    for k in range(20):
        one = stats.multivariate_t(shape=spread[k], df=TAIL_FREEDOM).logpdf(apart[k])
        assert found[k] == pytest.approx(one - np.log(DENSITY))


def test_two_panels_are_less_likely_where_each_drive_would_have_seen_both_from_the_front():
    sightings = make_sightings(road(1), [[0, 0, 0]] * 3, apart_ns=0)
    faces = np.array([True, True, False])  # the third saw it from behind
    i, j = np.array([0, 0]), np.array([1, 2])
    front, behind = miss_log_ratio(replace(sightings, front=faces), i, j, SETTINGS)
    assert front == pytest.approx(-2 * np.log(SETTINGS.missed))
    assert behind == pytest.approx(front / 2)
    grey = replace(sightings, front=faces, color=np.full(3, -1))  # whose cameras saw no colour
    assert miss_log_ratio(grey, i, j, SETTINGS).tolist() == [front, behind]
    later = np.array([0, 2, 2]) * 366 * DAY_NS  # the neighbour may have been put up since
    years = replace(sightings, front=faces, time_ns=later)
    assert 0 < miss_log_ratio(years, i, j, SETTINGS)[0] < front
    ever = replace(years, time_ns=later * 1000)
    largest = (
        SETTINGS.missed + MOST_CHANGED
    )  # as in the other ratios, faces change so often at most
    assert miss_log_ratio(ever, i, j, SETTINGS)[0] == pytest.approx(-2 * np.log(largest))


def off_by(sigmas, other_face=False):
    """Three drives of a road; the third measured panel 10 so many standard deviations along the road from its place."""
    sightings = make_sightings(road(20), [[0, 0, 0]] * 3, noise_m=0.02)
    sightings.position[50, 0] += sigmas * 0.05 * 2**0.5
    sightings.color[50] += other_face
    sightings.shape[50] += other_face
    return sightings


def test_a_measurement_farther_off_than_it_states_makes_no_second_panel():
    merged = merge_sightings(off_by(6), SETTINGS)
    assert len(set(merged.panel[[10, 30, 50]].tolist())) == 1
    assert len(merged.position) == 20


def test_a_spurious_sighting_near_a_panel_does_not_join_it():
    for sightings in (off_by(60), off_by(14, other_face=True)):
        merged = merge_sightings(sightings, SETTINGS)
        assert merged.place[merged.panel[50]] != merged.place[merged.panel[10]]
        assert merged.panel[10] == merged.panel[30]


def test_moved_panels_are_paired_one_to_one_as_many_as_can():
    pairs = np.array([[0, 0], [0, 1], [1, 0]])
    assert match_moved(pairs, np.array([1.0, 9.0, 9.0])).tolist() == [1, 2]
    assert match_moved(pairs[:0], np.zeros(0)).tolist() == []


@pytest.mark.parametrize(("wrong", "joined"), [((0,), False), ((0, 2), True), ((), False)])
def test_panels_stand_on_one_support_where_most_drives_that_saw_both_say_so(wrong, joined):
    sightings = make_sightings(road(20), [[0.0, 0, 0]] * 3)
    drives = np.isin(sightings.drive, wrong) & (sightings.row == 8)
    sightings.assembly[drives] = 7
    merged = merge_sightings(sightings, SETTINGS)
    assert merged.panel[7] != merged.panel[8]
    assert (merged.support[merged.panel[7]] == merged.support[merged.panel[8]]) == joined
