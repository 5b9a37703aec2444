"""Tables about the globe: exact places have no error, and the bound of the scale falls with the way."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Geod

ORIGIN = (38.5, -98.4, 500.0)


@pytest.fixture(scope="module")
def globe(load):
    return load("geometry_globe")


class Exact:
    """A run whose signs stand where they are, moved by metres along x and east."""

    def __init__(self, frames=48, moved=0.0, name="made up", way="fixes only"):
        self.name, self.way = name, way
        panels = [
            {"id": k, "station_m": 30.0 * k, "centre": [30.0 * k, 4.0, 2.0]} for k in range(5)
        ]
        self.truth = {
            "origin_wgs84": ORIGIN,
            "signs": panels,
            "frames": [{"position": [8.0 * n, 0.0, 2.0]} for n in range(frames)],
        }
        self.signs = [stated(p, moved * k) for k, p in enumerate(panels)]

    def evaluation(self):
        class Match:
            def __init__(self, k):
                self.sign_id, self.panel_id = k, k

        class Evaluation:
            matches = tuple(Match(k) for k in range(5))

        return Evaluation()


def stated(panel, moved):
    x, y, z = panel["centre"]
    bearing = np.degrees(np.arctan2(x + moved, y))
    lon, lat, _ = Geod(ellps="WGS84").fwd(ORIGIN[1], ORIGIN[0], bearing, np.hypot(x + moved, y))
    where = {"x": x + moved, "y": y, "z": z, "lon_deg": lon, "lat_deg": lat}
    return where | {"sign_id": panel["id"], "sigma_east_m": 1.0, "sigma_north_m": 1.0}


def test_signs_that_stand_right_have_no_error(globe):
    run = Exact()
    assert globe.neighbour_errors(run) == pytest.approx(np.zeros(4), abs=1e-9)
    away, sigma = globe.globe_errors(run)
    assert away == pytest.approx(np.zeros((5, 2)), abs=1e-6)
    assert (sigma == 1).all()


def test_errors_come_out_as_large_as_they_are(globe):
    run = Exact(moved=0.5)
    assert globe.neighbour_errors(run) == pytest.approx(np.full(4, 0.5))
    assert globe.globe_errors(run)[0][:, 0] == pytest.approx(0.5 * np.arange(5), abs=1e-4)


def test_a_longer_drive_leaves_less_doubt_of_the_scale(globe):
    short, long = globe.scale_bound(Exact(24)), globe.scale_bound(Exact(96))
    assert 0.02 < long < short < 0.5


def test_the_table_has_a_row_a_run(globe):
    rows = [line for line in globe.relation_table([Exact(), Exact(way="poses given")]) if line]
    assert rows[-2].startswith("| made up, fixes only | 4 | 0.0 / 0.0 | ")
    assert rows[-1].count("|") == 8


def test_made_up_steps_lead_along_the_true_path(globe):
    chain, measured, (_, laid), truth = globe.made_up(1, 60)
    assert chain.length[1:] == pytest.approx(np.full(59, globe.LONG_STEP_M), abs=0.1)
    assert np.abs(laid - truth).max() < 5
    assert np.abs(measured.position - truth).max() < 6
