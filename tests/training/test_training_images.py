"""Real images that are learned from: which sources."""

import pytest

from training.training_images import real_sources
from wayside.schemas.errors import InputError


def test_a_source_is_left_out_as_a_whole_and_one_of_another_name_is_refused(tmp_path):
    without = real_sources(tmp_path, ["ca_city_garmin"])
    assert real_sources(tmp_path).keys() - without.keys() == {"ca_city_garmin"}
    with pytest.raises(InputError, match=r"no sources garmin .*scenes_mixed"):
        real_sources(tmp_path, ["ca_city_garmin", "garmin"])


def test_nothing_is_learned_from_sources_that_are_for_tests_only(tmp_path):
    sources = real_sources(tmp_path)
    assert {"scenes/jd", "scenes/mi", "us_freeway_challenge"} <= sources.keys()
    for source in ("kitti", "autobahn", "mb", "crops"):
        assert source not in " ".join(sources)
