"""Signs of one type along made paths, and how far they stand apart."""

from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from wayside.schemas.frame import Pose, PosePrior
from wayside.schemas.settings import MotionSettings
from wayside.schemas.signs import SignCode
from wayside.stages.georeference import PathPoint, georeference, place_signs
from wayside.stages.roadside import measure_spacing

from ...made_landmarks import made_landmark

STEP_M, STEP_SIGMA_M, POSE_SIGMA_M, OWN_M = 8.0, 0.02, 0.01, 0.2
LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def path_of(n=60, radius_m=np.inf, poses=False, slope=0.0):
    """A drive with steps of known length, or with poses; turns right on a circle of that radius."""
    given, points = [], []
    for frame in range(n):
        turn = frame * STEP_M / radius_m
        along, aside = np.sinc(turn / np.pi), -np.sinc(turn / 2 / np.pi) * np.sin(turn / 2)
        centre = frame * STEP_M * np.array([along, aside, slope])
        c, s = np.cos(turn), np.sin(turn)
        given.append(Pose(np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) @ LEVEL, centre))
        noise = np.diag([1e-10] * 3 + [1e-6, 1e-6, STEP_SIGMA_M**2])
        prior = PosePrior(given[-1], POSE_SIGMA_M, 1e-3, "poses") if poses else None
        point = PathPoint(frame, given[-1].relative_to(given[0]), prior, None, frame * 10**9, noise)
        far = {"source": "poses" if poses else "straight", "station_m": frame * STEP_M}
        points.append(replace(point, baseline_m=STEP_M if frame else None, **far))
    (path,) = georeference(iter(points), MotionSettings())
    return path


def sign_at(station, code=None, *, path, status="sign", **changes):
    frame = int(np.clip(station // STEP_M - 1, 0, len(path.poses) - 1))
    right = changes.get("right_m", 3.0)
    place = np.array([right, -0.5, station - frame * STEP_M])
    seen = {"station_m": station, "best_frame": frame, "position": place}
    seen["covariance"] = np.diag([0.01, 0.01, OWN_M**2])
    number = round(station * 100)
    (sign,) = place_signs(iter([made_landmark(track_id=number, **seen | changes)]), path, 0.5)
    coded = None if code is None else SignCode("us", code, None, 0.99, None)
    named = {"number": number, "assembly": changes.get("assembly", number)}
    return replace(sign, code=coded, status=status, lateral_m=right, **named)


def next_of(signs, path):
    return {s.number: s for s in measure_spacing(iter(signs), path=path)}


def test_the_next_sign_is_of_the_same_code_side_and_direction_and_on_another_support():
    path = path_of()
    at = {"path": path}
    first = sign_at(20, "R2-1", assembly=7, **at)
    others = [
        sign_at(21, "R2-1", assembly=7, **at),
        sign_at(30, "R1-1", **at),
        sign_at(40, "R2-1", right_m=-4.0, **at),
        sign_at(50, "R2-1", facing_deg=80.0, **at),
        sign_at(60, "R2-1", status="uncertain", **at),
        sign_at(70, "R2-1", status="back", **at),
    ]
    assert next_of([first, *others], path)[2000].next_number is None
    found = next_of([first, *others, sign_at(90, "R2-1", **at)], path)
    assert found[2000].next_number == found[2100].next_number == 9000
    assert found[2000].spacing_m == pytest.approx(70)
    assert [found[n].next_number for n in (3000, 4000, 6000, 7000, 9000)] == [None] * 5


def test_signs_without_a_code_are_told_apart_by_colour_and_shape():
    path = path_of()
    row = [sign_at(20, "W", path=path), sign_at(60, None, path=path), sign_at(90, "W", path=path)]
    assert next_of(row, path)[2000].next_number == 6000
    row[1] = replace(row[1], landmark=replace(row[1].landmark, shape="rectangle"))
    assert next_of(row, path)[2000].next_number == 9000
    row[2] = replace(row[2], landmark=replace(row[2].landmark, color=None))
    assert next_of(row, path)[2000].next_number is None


@example([], Random(0))  # a drive without signs
@given(st.lists(st.integers(100, 40000), unique=True, max_size=12), st.randoms())
def test_the_stretches_of_a_type_add_up_whatever_the_order_of_the_signs(places, random):
    path = path_of()
    signs = [sign_at(place / 100, "R2-1", path=path) for place in places]
    random.shuffle(signs)
    found = [one.spacing_m for one in measure_spacing(iter(signs), path=path)]
    total = (max(places) - min(places)) / 100 if places else 0.0
    assert np.nansum(found) == pytest.approx(total, abs=1e-6)
    assert np.isnan(found).sum() == min(len(places), 1)


def test_the_error_is_that_of_the_steps_between_and_of_both_signs():
    path = path_of()
    near, far, third = (sign_at(station, "R2-1", path=path) for station in (20, 36, 420))
    sigma = [next_of(pair, path)[2000].sigma_spacing_m for pair in ([near, far], [near, third])]
    assert sigma == pytest.approx([np.sqrt(2 * OWN_M**2 + n * STEP_SIGMA_M**2) for n in (2, 50)])


def test_poses_bound_the_error_of_any_stretch_and_share_no_offset():
    path = path_of(poses=True)
    between = [path.length_variance(5, last) ** 0.5 for last in (6, 10, 50)]
    assert between[0] < between[1] < np.sqrt(2) * POSE_SIGMA_M
    assert between[2] == pytest.approx(between[1], rel=0.05)
    assert path.length_variance(50, 5) == path.length_variance(5, 50)
    assert path.length_variance(5, 5) == pytest.approx(0, abs=1e-12)


def test_the_spacing_is_level_where_the_world_is():
    path = path_of(poses=True, slope=0.1)
    pair = [sign_at(station, "R2-1", path=path) for station in (16, 96)]
    assert next_of(pair, path)[1600].spacing_m == pytest.approx(80, abs=1e-3)


@pytest.mark.parametrize("radius_m", [150.0, -400.0])
def test_the_radius_of_a_curve_is_that_of_its_circle_positive_to_the_right(radius_m):
    path = path_of(radius_m=radius_m)
    sign = next_of([sign_at(200, path=path)], path)[20000]
    assert sign.radius_m == pytest.approx(radius_m, rel=1e-3)
    assert sign.sigma_radius_m == pytest.approx(0.005 / 40 * radius_m**2, rel=0.01)


@pytest.mark.parametrize(("station", "radius_m"), [(200, np.inf), (200, 9000.0), (30, 150.0)])
def test_a_straight_road_and_the_ends_of_a_drive_have_no_radius(station, radius_m):
    path = path_of(radius_m=radius_m)
    assert np.isnan(next_of([sign_at(station, path=path)], path)[station * 100].radius_m)
