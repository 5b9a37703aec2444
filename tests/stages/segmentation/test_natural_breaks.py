"""Exact one-dimensional K-means against trying everything."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.stages.segmentation.natural_breaks import classes_of_values, optimal_breaks


def spread(counts, breaks):
    total = 0.0
    ends = [*breaks[1:], len(counts)]
    for start, end in zip(breaks, ends, strict=True):
        values, weights = np.arange(start, end), np.asarray(counts[start:end], float)
        if weights.sum() > 0:
            total += (weights * (values - np.average(values, weights=weights)) ** 2).sum()
    return total


histograms = st.lists(st.integers(0, 1000), min_size=1, max_size=12)


@given(histograms, st.integers(1, 4))
def test_no_other_division_into_classes_has_less_spread(counts, classes):
    classes = min(classes, len(counts))
    breaks = optimal_breaks(np.array(counts), classes)
    least = min(
        spread(counts, [0, *inner]) for inner in combinations(range(1, len(counts)), classes - 1)
    )
    assert spread(counts, breaks) == pytest.approx(least, abs=1e-6)


@given(st.lists(st.integers(0, 10**6), min_size=16, max_size=443), st.integers(2, 16))
def test_breaks_rise_from_zero(counts, classes):
    breaks = optimal_breaks(np.array(counts), classes)
    assert len(breaks) == classes
    assert breaks[0] == 0
    assert (np.diff(breaks) >= 0).all()


def test_more_classes_never_have_more_spread():
    counts = np.random.default_rng(3).integers(0, 5000, 443)
    spreads = [spread(counts, optimal_breaks(counts, k)) for k in range(2, 17)]
    assert (np.diff(spreads) <= 0).all()


def test_classes_of_values_follow_the_breaks():
    np.testing.assert_array_equal(
        classes_of_values(np.array([0, 2, 2, 5]), 7), [0, 0, 2, 2, 2, 3, 3]
    )


def test_an_empty_histogram_still_gives_classes():
    assert optimal_breaks(np.zeros(443), 16)[0] == 0


@pytest.mark.parametrize(
    ("counts", "classes"),
    [(np.ones(3), 4), (np.ones(3), 0), (-np.ones(3), 2), (np.ones((2, 2)), 2)],
)
def test_impossible_questions_are_refused(counts, classes):
    with pytest.raises(ValueError, match=r"outside 1 to the number of values|negative"):
        optimal_breaks(counts, classes)
