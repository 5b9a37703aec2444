"""What the viewer says of rows once all signs are known."""

import numpy as np

from wayside.pipeline.view.chains import inventory_table, opening, sign_figures
from wayside.schemas.models import GaussianClass, GaussianModel

from ..results import sign_row


def row(**change):
    lengths = ("station_m", "lateral_m", "up_m", "panel_width_m", "panel_height_m", "sigma_along_m")
    look = {"color": "red", "shape": "octagon", "views": 4, "confidence": 0.9}
    return sign_row("d-0001", **dict.fromkeys(lengths, 1.5) | look | change)


def test_a_row_is_headed_by_what_it_looks_like():
    assert sign_figures(row()).startswith("# d-0001: red octagon\n")
    assert sign_figures(row(color=None, shape=None)).startswith("# d-0001: ? ?\n")
    behind = row(status="back", color=None)
    assert sign_figures(behind).startswith("# d-0001: back octagon\n")
    assert "| d-0001 |  | back | octagon | 1.50 |" in inventory_table([behind])


def test_every_class_of_places_is_drawn_where_it_lies():
    places = {"right": (7.0, 0.5), "left": (-9.0, 0.4)}
    classes = tuple(
        GaussianClass(name, np.array(mean), np.eye(2), 4.0, "test", 1)
        for name, mean in places.items()
    )
    drawn = {
        one.path.rsplit("/", 1)[-1]: one
        for one in opening(GaussianModel("s", classes, "t")).entities
    }
    for name, (right, above) in places.items():
        (strip,) = drawn[name].parts
        (ring,) = strip.strips.as_arrow_array().to_pylist()
        np.testing.assert_allclose(np.mean(ring[:-1], axis=0), (right, -above), atol=0.1)
