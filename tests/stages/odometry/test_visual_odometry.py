"""A drive past textured plates under a textured sky, painted here, and the motion found in it."""

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.schemas.detections import Candidates, Detections, Regions
from wayside.schemas.frame import DUPLICATE, USED, Camera, Fix, Frame, Image, Pose, PosePrior
from wayside.schemas.settings import FeatureSettings, MotionSettings
from wayside.stages.odometry.features import extract_features
from wayside.stages.odometry.motion_agreement import image_step
from wayside.stages.odometry.tie_points import KeypointImage
from wayside.stages.odometry.visual_odometry import estimate_motion
from wayside.stages.segmentation import unsegmented

SETTINGS = MotionSettings()
CAMERA = Camera(1200, 900, 1050.0, 1050.0, 599.5, 449.5)
SPACING = 8.0
MOUNT = Rotation.from_euler("yx", [-0.6, 0.4], degrees=True)
"""Camera against the vehicle: the direction of travel lies 0.6 deg right of and 0.4 deg above its axis."""


def texture(shape, seed, block, spread=45.0):
    """Blocks of random grey: corners at every size."""
    height, width = shape[0] // block, shape[1] // block
    levels = np.random.default_rng(seed).normal(128, spread, (height, width)).clip(5, 250)
    blocks = cv2.resize(levels, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    return cv2.GaussianBlur(blocks, (0, 0), 0.8).astype(np.uint8)


def drive_poses(frames, yaw_deg=0.0, missing=()):
    """Poses of a vehicle on an arc with a little sway, the camera fixed on it; steps 8 m, or more where missing."""
    generator = np.random.default_rng(0)
    poses, heading, place = [], 0.0, np.zeros(3)
    for trigger in range(frames + len(missing)):
        if trigger not in missing:
            sway = Rotation.from_euler("xz", generator.normal(0, 0.1, 2), degrees=True)
            turn = Rotation.from_euler("y", heading, degrees=True) * MOUNT * sway
            poses.append(Pose(turn.as_matrix(), place.copy()))
        middle = np.radians(heading + yaw_deg / 2)
        place = place + SPACING * np.array([np.sin(middle), 0.0, np.cos(middle)])
        heading += yaw_deg
    return poses


class Scene:
    """Plates that face back along the road, either side and on the ground, before a sky at infinity."""

    def __init__(self, poses, plates=240):
        generator = np.random.default_rng(1)
        path = np.array([pose.centre for pose in poses])
        self.texture = [texture((48, 48), 100 + i, 12) for i in range(40)]
        station = generator.uniform(0, len(poses) + 9, plates)
        before = np.minimum(station.astype(int), len(path) - 1)
        along = path[before] + (station - before)[:, None] * (path[-1] - path[-2])
        side = generator.choice([-1, 1], plates) * generator.uniform(4, 18, plates)
        self.middle = along + np.c_[side, generator.uniform(-9, 4, plates), np.zeros(plates)]
        self.size = generator.uniform(1.5, 2.4, plates)
        self.sky = texture((1400, 2200), 7, 40, spread=20.0)

    def image(self, pose, movers=()):
        k = CAMERA.matrix
        sky = np.array([[1050.0, 0, 1100], [0, 1050.0, 700], [0, 0, 1]])
        view = cv2.warpPerspective(self.sky, k @ pose.rotation.T @ np.linalg.inv(sky), (1200, 900))
        size = np.r_[self.size, [2.0] * len(movers)]
        local = pose.to_camera(np.vstack([self.middle, *movers]))
        for i in np.argsort(-local[:, 2]):
            if 6 < local[i, 2] < 110:
                self._paint(view, local[i], size[i], self.texture[i % 40])
        noise = np.random.default_rng(int(abs(pose.centre).sum() * 1e6)).normal(0, 1.0, view.shape)
        return np.clip(view + noise, 0, 255).astype(np.uint8)

    @staticmethod
    def _paint(view, local, size, plate):
        scale = CAMERA.fx * size / local[2] / 47
        u, v = local[:2] / local[2] * CAMERA.fx + (CAMERA.cx, CAMERA.cy)
        reach = scale * 23.5 + 2
        if not (reach < u < 1200 - reach and reach < v < 900 - reach):
            return
        x, y, n = int(u - reach), int(v - reach), int(2 * reach) + 2
        warp = np.array([[scale, 0, u - x - 23.5 * scale], [0, scale, v - y - 23.5 * scale]])
        soft = cv2.GaussianBlur(plate, (0, 0), max(0.3, 0.5 / scale)) if scale < 0.8 else plate
        patch = cv2.warpAffine(soft, warp, (n, n), flags=cv2.INTER_LINEAR)
        cover = cv2.warpAffine(np.full((48, 48), 1.0, np.float32), warp, (n, n))
        part = view[y : y + n, x : x + n]
        h, w = part.shape
        part[:] = part * (1 - cover[:h, :w]) + patch[:h, :w] * cover[:h, :w]


def detections_of(images, **known):
    """Detections of images; `known` are Frame fields, one per image."""

    def classified():
        for i, grey in enumerate(images):
            frame = Frame(i, i * 10**8, None, USED, "jpeg", b"recorded", CAMERA, 1200, 900)
            frame = replace(frame, **{key: values[i] for key, values in known.items()})
            image = unsegmented(Image(frame, None, grey if frame.used else None))
            yield Detections(image, Candidates.of(Regions.empty()))

    return extract_features(classified(), FeatureSettings())


def motions(images, settings=SETTINGS, **known):
    return [m.motion for m in estimate_motion(detections_of(images, **known), settings)]


def turn_deg(first, second):
    """Between two rotations."""
    return np.degrees(Rotation.from_matrix(first.T @ second).magnitude())


def told(poses):
    return [PosePrior(pose, 0.02, 0.002, "poses") for pose in poses]


@lru_cache
def painted(frames=7, yaw_deg=0.0, missing=()):
    poses = drive_poses(frames, yaw_deg, missing)
    scene = Scene(poses)
    return poses, [scene.image(pose) for pose in poses]


@lru_cache
def driven(yaw_deg):
    """Poses of seven painted images and the motion that is found from them and their spacing."""
    poses, images = painted(7, yaw_deg)
    return poses, motions(images, spacing_m=[SPACING] * 7)


def errors(found, poses):
    """Rotation, sideways and vertical direction (deg), and length ratio of each step against the truth."""
    rows = []
    for i in range(1, len(poses)):
        true, step = poses[i].relative_to(poses[i - 1]), found[i].step
        slopes = (c.centre[:2] / c.centre[2] for c in (step, true))
        aside = np.degrees(np.subtract(*slopes))
        length = np.linalg.norm(step.centre) / np.linalg.norm(true.centre)
        rows.append((turn_deg(step.rotation, true.rotation), *np.abs(aside), length))
    return np.array(rows)


@pytest.mark.parametrize("yaw_deg", [0.0, 2.0], ids=["straight", "curve"])
def test_images_and_spacing_alone_give_the_motion(yaw_deg):
    poses, found = driven(yaw_deg)
    error = errors(found, poses)
    assert (np.median(error[:, :3], axis=0) < (0.02, 0.08, 0.08)).all()
    assert error[:, 0].max() < 0.1
    np.testing.assert_allclose(error[:, 3], 1.0, atol=2e-3)  # chord against arc on the curve
    assert all(m.adjusted and m.source == "straight" for m in found[1:])
    assert all(m.residual_px < 0.25 for m in found[1:])
    assert (found[0].source, found[0].step) == ("start", None)
    true = poses[6].relative_to(poses[0])  # poses and stations are chained from the first camera
    np.testing.assert_allclose(found[6].pose.centre, true.centre, atol=0.15)
    assert found[6].station_m == pytest.approx(6 * SPACING, rel=1e-3)


def test_tie_points_are_where_the_plates_stand():
    poses, found = driven(0.0)
    ties = found[3].ties
    solid = ties.inlier & (ties.point[:, 2] < 40)
    assert solid.sum() > 20
    local = poses[3].to_camera(Scene(poses).middle)
    shown = local[local[:, 2] > 5]
    pixels = shown[:, :2] / shown[:, 2:] * CAMERA.fx + (CAMERA.cx, CAMERA.cy)
    gaps = []
    for pixel, point in zip(ties.current[solid], ties.point[solid], strict=True):
        inside = np.abs(pixels - pixel).max(axis=1) < 1.5 * CAMERA.fx / shown[:, 2]
        if inside.any():
            gaps.append(np.abs(shown[inside, 2] - point[2]).min() / point[2])
    assert len(gaps) > 15
    assert np.median(gaps) < 0.02


def test_a_dropped_trigger_doubles_the_step():
    _, images = painted(6, 0.0, missing=(3,))
    found = motions(images, spacing_m=[SPACING] * 6)
    steps = [m.baseline_m / SPACING for m in found]
    np.testing.assert_allclose(steps, [0, 1, 1, 2, 1, 1], atol=0.03)
    assert [found[i].source for i in (2, 3, 5)] == ["straight", "points", "straight"]


def test_noisy_poses_are_made_better():
    poses, images = painted(7, 2.0)
    generator = np.random.default_rng(9)
    noisy = []
    for pose in poses:
        turn = Rotation.from_rotvec(generator.normal(0, 0.002, 3)).as_matrix()
        pose = Pose(pose.rotation @ turn, pose.centre + generator.normal(0, 0.02, 3))
        noisy.append(PosePrior(pose, 0.02, 0.002, "odometry"))
    found = motions(images, pose=noisy)
    given = [b.pose.relative_to(a.pose) for a, b in pairwise(noisy)]
    before = [
        turn_deg(g.rotation, b.relative_to(a).rotation)
        for g, (a, b) in zip(given, pairwise(poses), strict=True)
    ]
    error = errors(found, poses)
    assert np.median(error[:, 0]) < 0.3 * np.median(before)
    assert found[1].source == "odometry"
    assert np.abs(error[:, 3] - 1).max() < 0.01


@pytest.mark.parametrize("by_poses", [False, True])
def test_the_report_adjusts_only_where_the_straight_line_does_not_fit(by_poses):
    poses, images = painted(4, 2.0)
    report = MotionSettings(residual_px=0.5)
    known = {"pose": told(poses)} if by_poses else {"spacing_m": [SPACING] * 4}
    adjusted = motions(images, report, **known)
    assert all(m.adjusted for m in adjusted[1:])
    assert all(m.residual_straight_px > 0.5 > m.residual_px for m in adjusted[1:])
    found = motions(images, replace(report, residual_px=1e6), **known)
    assert not any(m.adjusted for m in found)
    np.testing.assert_array_equal(found[2].step.rotation, np.eye(3))
    assert found[2].iterations == 0
    assert found[2].ties is not None
    # what is not adjusted may be off by as much as the adjustment would have changed
    off = Rotation.from_matrix(adjusted[2].step.rotation).as_rotvec()
    assert np.linalg.norm(off) > np.radians(1)
    assert off @ np.linalg.solve(found[2].covariance[:3, :3], off) < 1
    assert off @ np.linalg.solve(adjusted[2].covariance[:3, :3], off) > 100


def test_a_curve_goes_on_where_ties_are_too_few_but_not_for_ever():
    poses, images = painted(4, 2.0)
    blank = np.full_like(images[0], 90)
    found = motions([*images[:3], blank, blank, blank, blank], spacing_m=[SPACING] * 7)
    turn = poses[1].relative_to(poses[0]).rotation
    assert [m.ties is None for m in found] == [True, False, False] + [True] * 4  # no duplicates
    assert [m.adjusted for m in found] == [False, True, True] + [False] * 4
    assert found[3].covariance[0, 0] > 100 * found[2].covariance[0, 0]
    for motion in found[3:5]:
        assert turn_deg(turn, motion.step.rotation) < 0.5
        # the mount is not known yet
        np.testing.assert_allclose(motion.step.centre, found[2].step.centre, atol=0.1)
    for motion in found[5:]:
        np.testing.assert_array_equal(motion.step.rotation, np.eye(3))


def test_a_frame_that_is_not_used_passes_and_is_stepped_over():
    _, images = painted(5, 0.0)
    status = [USED, USED, "skipped", USED, USED]
    found = motions(images, status=status, spacing_m=[8.0, 8.0, None, 16.0, 8.0])
    assert found[2] is None
    assert found[3].baseline_m == pytest.approx(16.0, rel=2e-3)
    assert found[4].station_m == pytest.approx(32.0, rel=2e-3)


def test_beyond_the_last_fix_points_carry_the_length_of_the_steps():
    poses, images = painted(7, 0.0, missing=(5,))
    degrees = np.degrees(1 / 6_371_000.0)
    fixes = [Fix(38 + pose.centre[2] * degrees, -97.0, 500.0, (0.1, 0.1, 0.1)) for pose in poses]
    found = motions(images, fix=[*fixes[:3], *[None] * 4])
    assert [m.source for m in found[1:]] == ["fixes"] * 2 + ["speed"] * 4
    length = [np.linalg.norm(b.centre - a.centre) for a, b in pairwise(poses)]
    assert max(length) == pytest.approx(2 * min(length), rel=0.01)  # one step is twice as fast
    np.testing.assert_allclose([m.baseline_m for m in found[1:]], length, rtol=0.02)


def saved_again(image, quality):
    """The image as JPEG of another quality."""
    content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)


def assert_nothing_gained(images, at, extra, **known):
    """The motion is the same with `extra` images after the first `at` ones, which come out as duplicates."""
    plain = motions(images, **{name: values[: len(images)] for name, values in known.items()})
    order = [*range(at), *[at - 1] * len(extra), *range(at, len(images))]
    given = [*images[:at], *extra, *images[at:]]
    known = {name: [values[i] for i in order] for name, values in known.items()}
    found = list(estimate_motion(detections_of(given, **known), SETTINGS))
    statuses = [item.frame.status for item in found]
    assert statuses == [USED] * at + [DUPLICATE] * len(extra) + [USED] * (len(images) - at)
    assert all(len(item.frame.data) == 0 for item in found if item.frame.status == DUPLICATE)
    used = [item.motion for item in found if item.motion is not None]
    assert [m.baseline_m for m in used] == [m.baseline_m for m in plain]
    np.testing.assert_array_equal(used[-1].pose.centre, plain[-1].pose.centre)


def test_copies_saved_again_add_nothing_to_the_way_whatever_the_poses_say():
    poses, images = painted(7, 0.0)
    assert_nothing_gained(images[:3], 2, [images[1], saved_again(images[1], 60)], pose=told(poses))


def test_a_vehicle_that_stands_while_others_drive_by_adds_nothing_to_the_way():
    poses = drive_poses(3)
    scene = Scene(poses)

    def view(i, ahead_m):
        places = [np.array([x, y, ahead_m]) for x in (-3.0, -1.0, 1.0, 3.0) for y in (-0.5, 1.5)]
        return scene.image(poses[i], [poses[i].to_world(place) for place in places])

    images = [view(i, 18.0) for i in range(3)]
    extra = [saved_again(view(1, ahead_m), 90) for ahead_m in (14.0, 27.0)]
    assert_nothing_gained(images, 2, extra, spacing_m=[SPACING] * 3)


def test_slow_motion_adds_up():
    start, *more = drive_poses(4)
    creep = [Pose(start.rotation, start.centre + np.array([0, 0, 0.4 * i])) for i in range(6)]
    scene = Scene([start, *more])
    found = motions([scene.image(pose) for pose in creep], pose=told(creep))
    used = [i for i, motion in enumerate(found) if motion is not None]
    assert 1 < len(used) < 6
    assert found[used[-1]].station_m == pytest.approx(0.4 * used[-1], abs=0.05)


def test_a_vehicle_that_reverses_as_its_poses_say_keeps_all_images():
    poses, images = painted(8)
    order = [*range(5), *range(3, 0, -1)]
    found = motions([images[i] for i in order], pose=told([poses[i] for i in order]))
    for motion, i in zip(found, order, strict=True):
        true = poses[i].relative_to(poses[0]).centre
        assert motion.pose.centre == pytest.approx(true, abs=0.3)


def test_an_image_and_itself_tell_no_step():
    image = KeypointImage.of(next(detections_of(painted()[1][:1])))
    assert image_step((0, 0), image, image, SETTINGS) is None
