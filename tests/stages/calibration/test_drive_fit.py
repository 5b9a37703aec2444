"""Self-calibration on simulated drives, whose camera is known exactly."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.pipeline.simulation.drive import SimulatedDrive, Survey
from wayside.schemas.frame import Camera
from wayside.schemas.settings import Settings
from wayside.stages.calibration import CalibrationWatch, watch_calibration
from wayside.stages.calibration.drive_fit import calibrate_drive
from wayside.stages.calibration.segment import cut_segments
from wayside.stages.calibration.segment_equations import changed_camera, displacement, project
from wayside.stages.geometry import distort_points, ideal_points, to_rays

IMAGES = 9
CURVE = {"curve_radius_m": 80.0, "jitter_deg": 0.3, "spacing_m": 4.0}


def drive(images=17, **survey):
    """Images of a simulated drive with their motion, and the true camera."""
    simulated = SimulatedDrive(Survey(ties=80, signs=1, **survey))
    posed = simulated.posed(Settings().motion)
    return [item for item, _ in zip(posed, range(images), strict=False)], simulated.camera


@pytest.fixture(scope="module")
def curve():
    return drive(**CURVE)


def scaled(camera, factor):
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)


def calibrated(items, camera):
    segments = cut_segments([item.motion for item in items], camera, IMAGES)
    return calibrate_drive(segments, camera, 5.0)


@pytest.mark.parametrize("factor", [pytest.param(0.9, marks=pytest.mark.slow), 1.1])
def test_a_curve_recovers_a_focal_length_that_is_off_by_a_tenth(curve, factor):
    items, camera = curve
    found = calibrated(items, scaled(camera, factor))
    assert found.focal_sigma < 0.04
    assert abs(np.log(found.camera.fx / camera.fx)) < 2 * found.focal_sigma
    assert found.camera.fy / found.camera.fx == pytest.approx(1.0)
    assert abs(found.camera.distortion[0]) < 3 * np.sqrt(found.covariance[3, 3])


@pytest.mark.slow
def test_poses_that_turn_make_the_focal_length_surer():
    items, camera = drive(**CURVE, pose_m=0.02, pose_deg=0.02)
    without = [replace(item, motion=replace(item.motion, source="straight")) for item in items]
    found = calibrated(items, scaled(camera, 1.1))
    assert abs(np.log(found.camera.fx / camera.fx)) < 2 * found.focal_sigma
    assert found.focal_sigma < 0.9 * calibrated(without, camera).focal_sigma


def processed(item, camera):
    """A simulated image as a run has it that takes its pixels for those of another camera."""
    taken_by = item.frame.camera

    def ideal(pixels):
        return ideal_points(camera, distort_points(taken_by, pixels))

    image = replace(item.detections.image, frame=replace(item.frame, camera=camera))
    segmentation = replace(item.detections.segmentation, image=image)
    detections, ties = replace(item.detections, segmentation=segmentation), item.motion.ties
    if ties is not None:
        ties = replace(ties, previous=ideal(ties.previous), current=ideal(ties.current))
    return replace(item, detections=detections, motion=replace(item.motion, ties=ties))


def watched(items, change=lambda camera: camera):
    """What a run says of the changed camera that it is given."""
    watch = CalibrationWatch(images=IMAGES)
    given = [processed(item, change(item.frame.camera)) for item in items]
    assert list(watch_calibration(iter(given), watch)) == given
    return watch.calibrate()


@pytest.mark.parametrize("wrong", [(0.14, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.3, 0.0)])
def test_a_run_notices_a_focal_length_and_a_distortion_that_cannot_be_right(curve, wrong):
    items, true = curve
    found = watched(items, lambda camera: changed_camera(camera, np.array(wrong)))
    assert found.refutes_given
    assert found.camera.fx == pytest.approx(true.fx, rel=0.05)
    assert found.camera.distortion[0] == pytest.approx(0.0, abs=0.05)
    assert found.displacement == pytest.approx(displacement(found.given, -np.array(wrong)), rel=0.5)


def test_a_run_is_silent_where_the_calibration_is_right_or_nothing_tells(curve):
    assert not watched(curve[0]).refutes_given
    unsure = watched(drive(jitter_deg=0.0, trigger_m=0.0)[0])
    assert not unsure.refutes_given
    assert not unsure.is_determined
    assert CalibrationWatch().calibrate() is None
    assert watched(curve[0][:1], lambda camera: scaled(camera, 1.15)) is None


@pytest.mark.parametrize("distortion", [(), (-0.3, 0.1, 0.001, -0.002, 0.01)])
def test_a_displacement_is_that_of_the_farthest_moved_point_of_the_image(distortion):
    camera = Camera(640, 480, 500.0, 510.0, 300.0, 250.0, distortion)
    longer, bent = np.array([[0.01, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1e-4, 0.0]])
    exact = 0.01 if distortion else 1e-9
    assert displacement(camera, longer) == pytest.approx(0.01, rel=exact)
    rays = np.array([*to_rays(camera, np.array([[639.0, 0.0]]))[0], 1.0])[None]
    after = project(changed_camera(camera, bent), rays).pixels[0]
    relative = np.linalg.norm(after - (639.0, 0.0)) / np.linalg.norm([339.0, 250.0])
    assert displacement(camera, bent) == pytest.approx(relative, rel=1e-3)


def test_a_watch_keeps_a_bounded_number_of_segments(curve):
    watch = CalibrationWatch(images=IMAGES, most=1)
    for item in curve[0]:
        watch.add(item.motion, item.frame.camera)
    ((angle, motions),) = watch.kept
    assert len(motions) == IMAGES
    assert angle == pytest.approx(8 * 4.0 / 80.0, abs=0.03)


@pytest.mark.parametrize(
    "distortion", [(), (-0.3, 0.1, 0.001, -0.002, 0.01), (-0.3, 0.1, 0.0, 0.0, 0.01, 0.1, 0.0, 0.0)]
)
def test_derivatives_of_a_projection_are_its_differences(distortion):
    camera = changed_camera(Camera(640, 480, 500.0, 510.0, 320.0, 240.0, distortion), np.zeros(5))
    rays = np.random.default_rng(1).uniform([-2, -2, 4], [2, 2, 8], (20, 3))
    seen, beside = project(camera, rays), project(camera, np.array([[1.0, 0.0, 0.2]]))
    assert not any(one.any() for one in beside[1:]), "a point beside the camera says something"
    lens, still = (camera.matrix, np.array(camera.distortion)), np.zeros(3)
    pixels, _ = cv2.projectPoints(rays, still, still, *lens)
    np.testing.assert_allclose(seen.pixels, pixels[:, 0], atol=1e-9)

    def pixels_after(ray, turn, lens):
        turned = (rays + ray) @ Rotation.from_rotvec(turn).as_matrix()
        return project(changed_camera(camera, lens), turned).pixels

    zero = np.zeros(3), np.zeros(3), np.zeros(5)
    atol = 1e-4, 1e-2, 1e-4
    for at, derivative in enumerate((seen.by_ray, seen.by_turn, seen.by_lens)):
        for i, step in enumerate(1e-5 * np.eye(len(zero[at]))):
            up, down = (pixels_after(*zero[:at], sign * step, *zero[at + 1 :]) for sign in (1, -1))
            slope = (up - down) / 2e-5
            np.testing.assert_allclose(derivative[:, :, i], slope, rtol=1e-5, atol=atol[at])
