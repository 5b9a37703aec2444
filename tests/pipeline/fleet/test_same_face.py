"""Two panels of two surveys look alike where nothing known of them differs."""

import pytest

from wayside.pipeline.fleet.changes import same_face

PANEL = {
    "color": "red",
    "shape": "octagon",
    "panel_width_m": 0.75,
    "panel_height_m": 0.75,
    "bearing_deg": 90.0,
}


@pytest.mark.parametrize(
    ("other", "alike"),
    [({}, True), ({"color": "blue"}, False), ({"color": None}, True), ({"shape": "circle"}, False)],
)
def test_a_colour_that_one_survey_could_not_see_tells_nothing(other, alike):
    assert same_face(PANEL, PANEL | other) == alike
