"""Where the signs of a drive stand: broad and the same on both sides at first, then as on this road."""

from hypothesis import given
from hypothesis import strategies as st

from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.landmark_evidence import LEAST_DENSITY, SURE, SignPlaces


def at(right, above=1.0, station=0.0):
    return FrenetOffset(station=station, right=right, above=above)


def with_signs(*offsets, score=SURE + 4):
    places = SignPlaces()
    for offset in offsets:
        places.add(offset, score)
    return places


@given(st.floats(0, 60), st.floats(-3, 12))
def test_before_the_first_sign_both_sides_are_alike(right, above):
    nothing_known = SignPlaces()
    assert nothing_known.log_density(at(right, above)) == nothing_known.log_density(
        at(-right, above)
    )


def test_what_is_expected_at_first_is_a_density():
    cells = [(r / 2, u / 2) for r in range(-400, 401) for u in range(-20, 30)]
    total = sum(2.718281828 ** SignPlaces().log_density(at(*cell)) for cell in cells) / 4
    assert 0.6 < total - LEAST_DENSITY * len(cells) / 4 < 1


def test_signs_far_from_the_path_make_others_there_likelier_and_those_near_it_less():
    road = with_signs(*(at(20.0 + k % 2, station=100.0 * k) for k in range(8)))
    far, near = at(21.0, station=900.0), at(-6.0, station=900.0)
    assert road.log_density(far) > SignPlaces().log_density(far) + 1
    assert road.log_density(near) < SignPlaces().log_density(near) - 0.5


def test_what_does_not_look_like_a_sign_says_nothing_of_where_signs_stand():
    doubtful = with_signs(*(at(20.0, station=100.0 * k) for k in range(8)), score=SURE - 6)
    place = at(20.0, station=900.0)
    assert abs(doubtful.log_density(place) - SignPlaces().log_density(place)) < 0.2


def test_panels_of_one_support_do_not_confirm_each_other():
    support = with_signs(at(20.0, 1.0), at(20.2, 2.0))
    assert support.log_density(at(20.1, 1.5)) == SignPlaces().log_density(at(20.1, 1.5))
