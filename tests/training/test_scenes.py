"""Real images that are learned from: which sources, and which of their faces are samples of classes."""

import numpy as np
import pytest

from wayside.pipeline.learning.detector_images import BACK, FRONT, labelled_image
from wayside.pipeline.learning.scenes import real_faces, real_sources
from wayside.schemas.errors import InputError

SIGN = [300, 215, 330, 245]


def image(name="a", *, side=FRONT, box=SIGN, color="red", shape="rectangle"):
    rgb = np.random.default_rng(3).normal(110, 6, (480, 640, 3)).clip(0, 255).astype(np.uint8)
    rgb[215:245, 300:330] = (180, 30, 40)
    face = (box, side, color, shape)
    return labelled_image("two", name, rgb, [face], (), fronts_complete=True, backs_complete=False)


def test_faces_of_known_classes_are_samples_of_colour_and_shape():
    shown = [image(), image("b", color=None), image("c", side=BACK), image("d", shape="cloud")]
    (face,) = real_faces(shown)
    assert (face.sign, face.color, face.shape) == ("a/0", "red", "rectangle")
    np.testing.assert_allclose(face.rgb, (180, 30, 40), atol=1)


def test_faces_of_few_pixels_are_no_samples():
    assert real_faces([image(box=[300, 215, 306, 221])]) == []


def test_a_source_is_left_out_as_a_whole_and_one_of_another_name_is_refused(tmp_path):
    without = real_sources(tmp_path, ["ca_city_garmin"])
    assert real_sources(tmp_path).keys() - without.keys() == {"ca_city_garmin"}
    with pytest.raises(InputError, match=r"scenes_mixed.*found garmin$"):
        real_sources(tmp_path, ["ca_city_garmin", "garmin"])


def test_nothing_is_learned_from_sources_that_are_for_tests_only(tmp_path):
    sources = real_sources(tmp_path)
    assert {"scenes/jd", "scenes/mi", "us_freeway_challenge"} <= sources.keys()
    for source in ("kitti", "autobahn", "mb", "crops"):
        assert source not in " ".join(sources)
