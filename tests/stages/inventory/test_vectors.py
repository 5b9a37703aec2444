"""The vector by which the panels of one drive differ from those of another."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from wayside.stages.inventory import Agreement, agreement_of, measure_differences, reference_vectors

from .made_sightings import make_sightings, road

OWN_M, STATED_M = 0.06, 0.03


def agreement(sightings):
    pairs = measure_differences(sightings, np.ones(len(sightings), bool))
    return agreement_of(pairs) if len(pairs.drive) else None


def make_drives(places, moved, *, alike=False, stated_m=STATED_M):
    """Two drives that see panels at the same places (n, 3), the second with all of them moved by (n, 3) or (3,)."""
    noise = np.random.default_rng(5).normal(0, OWN_M / 2, (2 * len(places), 3))
    position = np.concatenate([places, places + moved]) + noise
    face = np.zeros(len(places), np.int64) if alike else np.arange(len(places))
    return make_sightings(position, 2, own_m=OWN_M, common_m=stated_m, face=face)


@pytest.mark.parametrize(
    "vector", [(0.5, 0, 0), (-1.8, 2.4, 0.5), (6, -8, 0), (1, 0, 45), (0, 0, -45)]
)
@pytest.mark.parametrize("changed", [0, 3])
def test_a_vector_far_beyond_what_receivers_state_is_found(vector, changed):
    moved = np.tile(np.array(vector, float), (10, 1))
    moved[:changed, 0] += [4.0, -7.0, 90.0][:changed]  # the third has no like within reach
    found = agreement(make_drives(road(10, 60.0), moved))
    assert found.clear
    assert found.vector_m == pytest.approx(vector, abs=3 * OWN_M / 10**0.5)
    assert found.supports == 10 - changed
    assert (found.sigma_m < 0.1).all()


def test_what_the_receivers_state_explains_is_no_vector():
    found = agreement(make_drives(road(10, 60.0), np.array([4.0, 3.0, 0.0]), stated_m=1.0))
    assert not found.vector_m.any()


def test_a_datum_shows_although_the_common_error_of_the_fixes_drifts_by_metres():
    moved = np.array([12.0, 0, 0]) + np.linspace([-2.0, 1, 0], [2.0, -1, 0], 30)
    found = agreement(make_drives(road(30, 60.0), moved, stated_m=1.0))
    assert np.linalg.norm(found.vector_m - [12, 0, 0]) < 1.5


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_panels_are_no_evidence(count):
    assert agreement(make_drives(road(count, 60.0), np.array([3.0, 0, 0]))) is None


@pytest.mark.parametrize(("moved", "panels"), [(1, 20), (6, 20), (10, 20)])
def test_panels_that_were_moved_alike_among_others_that_were_not_are_no_vector(moved, panels):
    by = np.zeros((panels, 3))
    by[:moved, 0] = 1.4
    found = agreement(make_drives(road(panels, 60.0), by))
    assert found is None or not found.vector_m.any()


def test_panels_on_one_support_are_one_witness():
    places = road(8, 0.0) + np.column_stack([np.zeros((8, 2)), np.arange(8)])
    drives = make_drives(places, np.array([3.0, 0, 0]))
    assert agreement(drives) is not None
    assert agreement(replace(drives, assembly=np.zeros(16, np.int64))) is None


@pytest.mark.parametrize("vector", [3.0, 12.0])
def test_in_a_row_of_equal_panels_alone_no_vector_is_taken(vector):
    found = agreement(make_drives(road(12, 12.0) * [1, 0, 1], np.array([vector, 0, 0]), alike=True))
    assert not found.clear
    assert reference_vectors({(0, 1): found}, {0: 0, 1: 1}) == {}


def test_panels_that_have_no_like_tell_the_vector_beside_a_row_of_equal_ones():
    places = np.concatenate([road(12, 60.0), road(10, 12.0) * [1, 0, 1] + np.array([1000.0, 0, 0])])
    drives = make_drives(places, np.array([5.0, 0, 0]))
    row = drives.row >= 12
    drives.color[row] = drives.shape[row] = 1
    found = agreement(drives)
    assert found.clear
    assert found.vector_m == pytest.approx([5, 0, 0], abs=0.1)


def edge(x, supports):
    return Agreement(np.array([x, 0.0, 0.0]), np.full(3, 0.1), supports)


def test_every_drive_is_brought_to_those_that_most_agree_or_to_the_earliest():
    found = {(0, 1): edge(3.0, 9), (1, 2): edge(0.0, 5), (0, 3): edge(-4.0, 9)}
    for pairs in permutations(found.items()):  # whose order does not matter
        vectors = reference_vectors(dict(pairs), {0: 10, 1: 40, 2: 30, 3: 20})
        told = {d: (r, v.vector_m[0]) for d, (r, v) in vectors.items()}
        assert told == {0: (2, -3.0), 3: (2, -7.0)}
    two = reference_vectors({(0, 1): edge(3.0, 9)}, {0: 50, 1: 40})
    assert {d: (r, v.vector_m[0]) for d, (r, v) in two.items()} == {0: (1, -3.0)}
