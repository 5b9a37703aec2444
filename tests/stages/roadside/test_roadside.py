"""The ground and the lines along the path, on images that are rendered from a known cross-section."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.schemas.detections import Candidates, Detections
from wayside.schemas.frame import USED, Camera, Frame, Image, Pose
from wayside.schemas.motion import Motion, PosedDetections
from wayside.schemas.roadside import Roadside
from wayside.stages.georeference import PathPoint
from wayside.stages.georeference.path import drive_path
from wayside.stages.roadside import on_road, place_sections, sweep_roadside
from wayside.stages.roadside.breaks import breaks_of
from wayside.stages.roadside.ground import ground_of
from wayside.stages.roadside.images import agreement, ground_image
from wayside.stages.roadside.lines import COLUMN_M, painted_lines
from wayside.stages.roadside.sweep import HEIGHTS_M, OFFSETS_M, Sweep
from wayside.stages.segmentation import unsegmented

from ...made_landmarks import made_motion

CAMERA = Camera(800, 600, 700.0, 700.0, 399.5, 279.5, (-0.1, 0.02, 0.0, 0.0, 0.0))
CAMERA_M, STEP_M = 2.0, 6.0
SECTION = np.array([[-20, 0.4], [-8, -1.0], [-4, 0.0], [4, 0.0], [8, -1.0], [20, 0.4]])
"""Offset and height of the breaks of the ground: shoulders at 4 m, ditches at 8 m."""
PLACE = Pose(np.array([[0.0, 1, 0], [0, 0, -1], [1, 0, 0]]), np.zeros(3))
"""At the camera: along, right and up."""
LINES_M = (-1.8, 1.7)
HIDDEN_M = (-12.5, -9.5)
"""Here every image shows something else, as behind a bush."""


def texture(rng):
    """Grey noise (4096, 1024), a texel 4 cm, that is the same in any two places nowhere."""
    fine = rng.normal(0, 20, (4096, 1024))
    coarse = cv2.resize(rng.normal(0, 25, (512, 256)), (1024, 4096), interpolation=cv2.INTER_CUBIC)
    return (120 + cv2.GaussianBlur(fine, (0, 0), 2) * 5 + coarse).astype(np.float32)


def rendered(ground, other, pose):
    """What the camera sees of the ground; `other` is the ground of the hidden strip."""
    rows, columns = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float32)
    pixels = np.stack([columns, rows], -1).reshape(-1, 1, 2)
    lens = np.array(CAMERA.distortion)
    rays = cv2.undistortPoints(pixels, CAMERA.matrix, lens)[:, 0].astype(np.float64)
    rays = np.column_stack([rays, np.ones(len(rays))]) @ pose.rotation.T
    down = np.maximum(rays[:, 1], 1e-3)
    far = CAMERA_M / down
    for _ in range(15):
        far = (CAMERA_M - np.interp(rays[:, 0] * far, *SECTION.T)) / down
    right, along = rays[:, 0] * far, rays[:, 2] * far + pose.centre[2]
    place = [((along + 4) / 0.04) % 4090, (right / 0.04 + 512).clip(0, 1020)]
    maps = [x.astype(np.float32).reshape(rows.shape) for x in (place[1], place[0])]
    own, hidden = (cv2.remap(x, *maps, cv2.INTER_LINEAR) for x in (ground, other))
    right = right.reshape(rows.shape)
    grey = np.where((right > HIDDEN_M[0]) & (right < HIDDEN_M[1]), hidden, own)
    painted = np.min([np.abs(right - line) for line in LINES_M], axis=0) < 0.06
    return np.clip(np.where(painted, 230, grey), 1, 255).astype(np.uint8)


def drive(frames, roll_deg=0.0):
    rng = np.random.default_rng(5)
    ground, roll = texture(rng), Rotation.from_euler("z", roll_deg, degrees=True).as_matrix()
    for k in range(frames):
        pose = Pose(roll, np.array([0.0, 0.0, STEP_M * k]))
        grey = rendered(ground, texture(rng), pose)
        frame = Frame(k, k, None, USED, "jpeg", b"", CAMERA, CAMERA.width, CAMERA.height)
        found = unsegmented(Image(frame, None, grey))
        step = Pose(np.eye(3), np.array([0.0, 0.0, STEP_M])) if k else None
        numbers = (STEP_M, STEP_M * k, None, 0.0, 0.0, False, 0, CAMERA_M + 0.05)
        motion = Motion(pose, step, None, "straight", *numbers)
        yield PosedDetections(Detections(found, Candidates.of(found.regions)), motion)


def sections_of(frames, roll_deg=0.0, world="drive_start"):
    """The cross-sections, in a world with z up, and the path."""
    sweeps = []
    passed = list(sweep_roadside(drive(frames, roll_deg), sweeps))
    assert len(passed) == frames
    points = [
        PathPoint(p.frame.index, p.motion.pose, None, None, station_m=p.motion.station_m)
        for p in passed
    ]
    up = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # from the first camera to x ahead, z up
    poses = {p.frame: Pose(up @ p.chained.rotation, up @ p.chained.centre) for p in points}
    path = drive_path(points, world, poses)
    return list(place_sections(iter(sweeps), path)), path


@pytest.fixture(scope="module")
def straight():
    return sections_of(14)


def errors(section):
    return section.height_m - np.interp(section.offset_m, *SECTION.T)


def test_heights_of_the_ground_are_measured_every_eight_metres(straight):
    sections, _ = straight
    assert [one.station_m for one in sections] == [8.0 * n for n in range(10)]
    for one in sections[4:]:
        measured = np.array(one.status) == "ground"
        assert measured.sum() >= 18
        assert np.abs(errors(one)[measured]).max() < 0.1
        assert np.median(np.abs(errors(one)[measured])) < 0.03


def test_ground_that_no_two_images_show_alike_is_hidden(straight):
    hidden = slice(0, 3)
    assert {status for one in straight[0][4:] for status in one.status[hidden]} == {"hidden"}


def test_ground_that_no_image_shows_is_unseen(straight):
    first = straight[0][1]  # 8 m from the start: the lens sees 6 m to each side there
    assert first.status[0] == first.status[-1] == "unseen"
    assert np.isnan(first.height_m[0])
    assert first.pairs[0] == 0


def test_the_stated_errors_are_of_the_size_of_the_true_ones(straight):
    ratio = np.concatenate(
        [(errors(one) / one.sigma_m)[np.array(one.status) == "ground"] for one in straight[0][4:]]
    )
    assert 0.2 < np.percentile(np.abs(ratio), 68) < 1.5


def test_lines_breaks_and_slopes_are_those_of_the_road(straight):
    for one in straight[0][4:]:
        left, right = one.sides
        assert [left.line_m, right.line_m] == pytest.approx([1.8, 1.7], abs=0.04)
        assert [left.edge_m, right.edge_m] == pytest.approx([1.8, 1.7], abs=0.04)
        assert one.lane_width_m == pytest.approx(3.5, abs=0.06)
        assert [right.shoulder_m, right.ditch_m] == pytest.approx([4.0, 8.0], abs=0.5)
        assert right.ditch_height_m == pytest.approx(-1.0, abs=0.1)
        assert right.fore_slope == pytest.approx(-0.25, abs=0.04)
        assert right.back_slope == pytest.approx(1.4 / 12, abs=0.05)


def test_the_height_of_the_camera_is_that_of_the_sweep_not_of_the_ties(straight):
    sections, path = straight
    assert on_road(path, sections).camera_height_m == pytest.approx(CAMERA_M, abs=0.02)
    assert on_road(path, []) is path


def test_a_rolled_camera_tilts_the_ground_unless_poses_tell_which_way_is_up():
    (*_, level), _ = sections_of(9, roll_deg=1.0, world="log")
    (*_, tilted), _ = sections_of(9, roll_deg=1.0)
    right = (np.array(level.status) == "ground") & (level.offset_m > 5)
    assert right.sum() >= 4
    assert np.abs(errors(level)[right]).max() < 0.08
    assert np.abs(errors(tilted)[right]).min() > 0.08
    assert (tilted.sigma_m[right] > 0.04).all()
    assert (level.sigma_m < tilted.sigma_m)[right].all()


def test_images_close_together_or_without_motion_are_not_compared():
    sweeps = []
    still = [one for one in drive(3)]
    near = [PosedDetections(still[0].detections, None)]
    assert list(sweep_roadside(iter(near + still[:1]), sweeps)) == near + still[:1]
    assert sweeps == []


def test_a_strip_that_shows_nothing_follows_its_neighbours():
    heights = np.arange(-1.0, 1.05, 0.1)
    peak = np.exp(-(((heights - 0.53) / 0.15) ** 2))
    score = np.stack([peak, peak * 0, peak, peak * 0])
    found = ground_of(score, np.array([2.0, 2.0, 2.0, 0.0]) / 2, heights)
    assert found.height[:3] == pytest.approx([0.53, 0.5, 0.53], abs=0.04)
    assert found.margin[0] > 0.3
    assert found.margin[1] <= 0
    assert np.isnan(found.height[3])


def flat(fall=0.0):
    """Scores of ground 0.2 m down that falls by so much a metre from 4 m to the right on."""
    height = -0.2 - fall * np.maximum(OFFSETS_M - 4, 0)
    return np.exp(-(((HEIGHTS_M - height[:, None]) / 0.2) ** 2)).astype(np.float32)


def seen(score, *lines):
    """The cross-sections where one score and these lines are seen every eight metres."""
    pairs = np.ones(len(OFFSETS_M), np.int64)
    own = [np.array(found).reshape(-1, 3) for found in lines]
    sweeps = [Sweep(0, 8.0 * k, PLACE, 1.5, score, pairs, one) for k, one in enumerate(own)]
    point = PathPoint(0, Pose(np.eye(3), np.zeros(3)), None, None)
    return list(
        place_sections(iter(sweeps), drive_path([point], "drive_start", {0: point.chained}))
    )


def test_what_stands_upright_is_hidden_and_hides_what_lies_beyond():
    score = flat()
    score[OFFSETS_M == 6] = np.where((HEIGHTS_M > -0.3) & (HEIGHTS_M < 0.8), 0.9, 0.2)
    for one in seen(score, *[[]] * 5):
        hidden = np.array(one.status) == "hidden"
        assert one.offset_m[hidden] == pytest.approx(np.arange(6.0, 13.0))
        assert one.camera_m == pytest.approx(1.7, abs=0.02)


def test_the_edge_is_the_outermost_solid_line_on_pavement_and_no_other_where_that_is_hidden():
    outer, inner, right, rail = ((x, 1.0, -1.7) for x in (-5.3, -1.8, 1.7, 5.5))
    free, traffic = [outer, inner, right, rail], [inner, right, rail]
    sections = seen(flat(0.2), *[free] * 4, *[traffic] * 5, *[free] * 4)
    left = [one.sides[0].edge_m for one in sections]
    assert left[:4] + left[-4:] == pytest.approx([5.3] * 8, abs=0.05)
    assert np.isnan(left[6])
    assert [one.sides[1].edge_m for one in sections] == pytest.approx([1.7] * 13, abs=0.05)


def test_samples_agree_by_what_changes_along_the_road():
    rng = np.random.default_rng(1)
    ground = rng.normal(size=(1, 4, 40)).astype(np.float32)
    line = np.zeros_like(ground) + np.array([0, 0, 80, 0], np.float32)[:, None]
    noise = rng.normal(size=ground.shape).astype(np.float32)
    assert agreement(ground + line, 3 * ground)[0] > 0.999
    assert abs(agreement(ground + line, noise + line)[0]) < 0.3
    ground[..., 10:] = np.nan
    assert np.isnan(agreement(ground, noise)[0])
    with pytest.raises(ValueError, match="second"):
        agreement(ground, noise[:, :2].copy())


def test_a_lens_is_undone_and_what_lies_outside_is_not_sampled():
    one, other = (texture(np.random.default_rng(seed)) for seed in (3, 4))
    grey = rendered(one, other, Pose(np.eye(3), np.zeros(3)))
    image = ground_image(grey, CAMERA, 0, made_motion(0, camera_height_m=CAMERA_M))
    place = Pose(PLACE.rotation, np.array([0.0, 0.0, 10.0]))
    right, along = np.array([-1.8, 30.0]), np.linspace(-2, 2, 9)
    seen = image.samples(place, along, right, np.array([-CAMERA_M, -CAMERA_M]), 0)
    assert (seen[0] > 200).all()  # the painted line
    assert np.isnan(seen[1]).all()
    with pytest.raises(ValueError, match="up"):
        image.samples(place, along, right, right[:1], 0)


def test_lines_are_found_with_the_part_that_is_painted():
    strip = np.random.default_rng(2).normal(100, 4, (400, 32)).astype(np.float32)
    strip[97:103] += 60  # solid
    strip[247:253, :10] += 60  # a dash
    strip[300:] += 60  # pavement, no line
    strip[380:] = np.nan
    (solid, dashed) = painted_lines(strip)
    assert solid == pytest.approx([99.5, 1.0], abs=1.0)
    assert dashed[0] == pytest.approx(249.5, abs=1.0)
    assert dashed[1] == pytest.approx(10 / 32, abs=0.05)
    assert COLUMN_M * 6 == pytest.approx(0.12)
    assert len(painted_lines(np.full((400, 32), np.nan, np.float32))) == 0


def test_straight_ground_has_no_breaks_and_a_curb_or_shoulder_one():
    at = np.arange(13.0)
    sigma = np.full(13, 0.03)
    plain = -0.02 * at + np.random.default_rng(0).normal(0, 0.03, 13)
    assert breaks_of(at, plain, sigma) == Roadside()
    found = breaks_of(at, plain - 0.2 * np.maximum(at - 4.5, 0), sigma)
    assert found.shoulder_m == pytest.approx(4.5, abs=0.5)
    assert found.fore_slope == pytest.approx(-0.22, abs=0.03)
    assert np.isnan(found.ditch_m)
    assert breaks_of(at[:4], plain[:4], sigma[:4]) == Roadside()
