"""Which places are in view of a camera that looks north."""

import numpy as np
import pytest

from wayside.schemas.frame import Camera
from wayside.schemas.settings.merging import MergeSettings
from wayside.stages.inventory import PanelPlaces, gone_probability, views_of

CAMERA = Camera(1600, 1200, 1400.0, 1400.0, 799.5, 599.5)
NORTH = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.mark.parametrize(
    ("place", "bearing_deg", "count"),
    [
        ((4, 30, 2), 180, 1),  # 35 px high, its face to the camera
        ((4, 90, 2), 180, 0),  # 12 px
        ((4, -30, 2), 180, 0),  # behind
        ((25, 30, 2), 180, 0),  # beside the image
        ((4, 30, 2), 0, 0),  # from behind
        ((4, 30, 2), np.nan, 1),  # facing unknown
        ((16.9, 30, 2), 180, 0),  # cut by the border of the image
    ],
)
def test_a_place_is_in_view_where_its_panel_would_show_whole_large_and_from_the_front(
    place, bearing_deg, count
):
    places = PanelPlaces(
        np.array([place], float), np.radians([bearing_deg]), np.array([[0.75, 0.75]])
    )
    found = views_of(places, np.array([[0.0, 0, 2]]), NORTH[None], CAMERA, 25.0)
    assert found.height[0].tolist() == pytest.approx([35.0 * count])
    if count:
        assert found.box[0, 0].tolist() == pytest.approx([968.67, 582.0, 1003.67, 617.0], abs=0.01)


def test_a_panel_is_gone_the_surer_the_more_drives_looked_and_the_surer_it_was_one():
    settings = MergeSettings(missed=0.1, change_per_year=0.08)
    found = [gone_probability(1.0, 1.0, looks, 0, settings) for looks in range(4)]
    assert found == pytest.approx([0.08 / (0.08 + 0.92 * 0.1**looks) for looks in range(4)])
    for looks in range(4):
        unsure = gone_probability(0.9, 1.0, looks, 0, settings)
        assert gone_probability(0.9, 1.0, looks, 1, settings) < unsure < found[looks]
        assert gone_probability(1.0, 0.0, looks, 0, settings) == 0
