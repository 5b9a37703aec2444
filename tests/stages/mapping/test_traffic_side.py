"""Traffic on the left: where signs stand is mirrored once the signs of the drive say so."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import MappingSettings, VerdictSettings
from wayside.stages.mapping import LandmarkClassifier, SideClassifiers, left_traffic_ratio, track
from wayside.stages.mapping.landmark_evidence import FEATURES

RIGHT = GaussianModel(
    "right_up_m",
    (GaussianClass("c", np.array([4.0, 0.0]), np.array([[1.0, 0.2], [0.2, 2.0]]), 9.0, "test", 1),),
    "test",
)


@pytest.fixture
def classifier(evidence_model):
    """Signs by the number of their views, their place against them."""
    model = replace(evidence_model(log_views=10.0, place_sigmas=-1.0), terms=("views", "place"))
    return LandmarkClassifier(model, RIGHT)


def signs_of(frames, classifier, left_traffic=-3.0):
    settings = MappingSettings(verdict=VerdictSettings(left_traffic=left_traffic))
    front = SideClassifiers(landmark=classifier)
    found = [one for item in track(iter(frames), settings, front) for one in item.landmarks]
    return sorted(found, key=lambda one: one.station_m)


def sigmas(landmark):
    return landmark.features[FEATURES.index("place_sigmas")]


def along_the_road(panel, drive, right):
    return drive([panel(right, 1.2, along) for along in (110.0, 210.0, 310.0, 410.0)], 55)


@given(right=st.floats(-50, 50), above=st.floats(-5, 15))
def test_a_mirrored_model_is_as_far_from_a_mirrored_place(right, above):
    own, other = np.array([[right, above]]), np.array([[-right, above]])
    np.testing.assert_allclose(RIGHT.mirrored().distances(other), RIGHT.distances(own))
    np.testing.assert_array_equal(RIGHT.mirrored().mirrored().distances(own), RIGHT.distances(own))


def test_signs_on_the_left_mirror_where_later_ones_are_expected(panel, drive, classifier):
    found = signs_of(along_the_road(panel, drive, -4.0), classifier)
    assert sigmas(found[0]) > 5
    assert sigmas(found[-1]) < 1.5
    assert left_traffic_ratio(found, classifier) > 10


def test_signs_on_the_right_leave_everything_as_it_is(panel, drive, classifier):
    found = signs_of(along_the_road(panel, drive, 4.0), classifier)
    assert max(map(sigmas, found)) < 1.5
    assert left_traffic_ratio(found, classifier) < -10


@pytest.mark.parametrize(("left_traffic", "expected"), [(-99, False), (99, True)])
def test_the_setting_alone_decides_where_it_is_certain(
    panel, drive, classifier, left_traffic, expected
):
    found = signs_of(along_the_road(panel, drive, -4.0), classifier, left_traffic)
    assert [sigmas(one) < 1.5 for one in found] == [expected] * 4


def test_backs_and_what_is_a_sign_by_its_place_alone_say_nothing(panel, drive, classifier):
    (found,) = signs_of(drive([panel(-4.0, 1.2, 110.0)], 20), classifier)
    assert left_traffic_ratio([found], classifier) > 3
    place = dict(found.evidence)["place"]
    for other in (
        replace(found, back=True),
        replace(found, verdict="location"),
        replace(found, score=place - 0.1),
        replace(found, features=(), evidence=()),
    ):
        assert left_traffic_ratio([other], classifier) == 0
    assert left_traffic_ratio([found], LandmarkClassifier()) == 0


def test_evidence_without_a_term_of_places_says_nothing(panel, drive, classifier, evidence_model):
    without = replace(classifier, model=evidence_model(log_views=10.0))
    found = signs_of(along_the_road(panel, drive, -4.0), without)
    assert len(found) == 4
    assert left_traffic_ratio(found, without) == 0
