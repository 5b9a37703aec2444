"""Intervals of shares and rates, beside their closed forms and what scipy gives."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, poisson

from wayside.pipeline.statistics import rate_interval, share_interval

COUNTS = st.integers(1, 300).flatmap(lambda total: st.tuples(st.integers(0, total), st.just(total)))


@given(COUNTS)
def test_the_interval_of_a_share_is_wilsons_and_at_both_ends_the_exact_one(counts):
    count, total = counts
    method = "wilson" if 0 < count < total else "exact"
    named = binomtest(count, total).proportion_ci(0.95, method)
    assert share_interval(count, total) == pytest.approx((named.low, named.high), abs=1e-12)


@given(st.integers(0, 500), st.floats(0.1, 100))
def test_the_ends_of_a_rate_leave_a_fortieth_on_each_side(count, exposure):
    interval = rate_interval(count, exposure)
    assert interval is not None
    assert poisson.cdf(count, interval.high * exposure) == pytest.approx(0.025, abs=1e-6)
    if count:
        assert poisson.sf(count - 1, interval.low * exposure) == pytest.approx(0.025, abs=1e-6)
    else:
        assert interval.low == 0


def test_of_nothing_there_is_no_interval():
    assert share_interval(0, 0) is None
    assert rate_interval(0, 0.0) is None
