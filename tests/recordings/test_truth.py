"""What the truth of a drive says of its signs, reckoned again from camera positions, panels and boxes alone."""

import json
from pathlib import Path

import numpy as np
import pytest

TRUTH = json.loads(
    (Path(__file__).parents[2] / "recordings" / "demo.truth.json").read_text(encoding="utf-8")
)
CAMERAS = np.array([frame["position"] for frame in TRUTH["frames"]])
SIGNS = [pytest.param(sign, id=str(sign["id"])) for sign in TRUTH["signs"]]
PASSED_M = TRUTH["frames"][-1]["travelled_m"]
PASSED = [one for one in SIGNS if one.values[0]["station_m"] < PASSED_M]


def beside_the_path(sign):
    """Segment of the path that the sign stands beside, its direction (2,), and distance along and right of it."""
    point, start, end = np.array(sign["centre"][:2]), CAMERAS[:-1, :2], CAMERAS[1:, :2]
    length = np.linalg.norm(end - start, axis=1)
    ahead = (end - start) / length[:, None]
    along = np.clip(((point - start) * ahead).sum(axis=1), 0, length)
    gap = np.linalg.norm(start + along[:, None] * ahead - point, axis=1)
    k = int(gap.argmin())
    right = np.array([ahead[k][1], -ahead[k][0]])
    return k, ahead[k], length[:k].sum() + along[k], float((point - start[k]) @ right)


@pytest.mark.parametrize("sign", PASSED)
def test_station_and_offset_are_those_of_the_path_of_the_cameras(sign):
    _, _, station, right = beside_the_path(sign)
    assert sign["station_m"] == pytest.approx(station, abs=0.5)
    assert sign["lateral_m"] == pytest.approx(right, abs=0.3)


@pytest.mark.parametrize("sign", PASSED)
def test_the_facing_is_the_turn_of_the_panel_from_the_vehicle_clockwise_from_above(sign):
    _, ahead, _, _ = beside_the_path(sign)
    (east, north), normal = -ahead, np.array(sign["normal"])
    bearings = np.degrees(np.arctan2([normal[0], east], [normal[1], north]))
    turned = (bearings[0] - bearings[1] + 180) % 360 - 180
    assert (sign["facing_deg"] - turned + 180) % 360 - 180 == pytest.approx(0, abs=3)
    assert sign["faces_travel"] == (abs(sign["facing_deg"]) < 60)


@pytest.mark.parametrize("sign", SIGNS)
def test_frames_that_count_show_half_of_a_front_that_is_ten_pixels_tall(sign):
    counted = [
        view["side"] == "front"
        and view["box"][3] - view["box"][1] >= 10
        and view["visible_fraction"] >= 0.5
        for view in sign["frames"]
    ]
    assert sign["eligible_frames"] == sum(counted)
