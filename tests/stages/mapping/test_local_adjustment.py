"""A landmark adjusted with the motion around it, on exact scenes whose chained motion is wrong in part."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Camera, Pose
from wayside.schemas.motion import Motion, StepPrior, Ties
from wayside.stages.mapping import local_adjustment
from wayside.stages.mapping.local_adjustment import MOST_FRAMES, adjust_jointly, window_around
from wayside.stages.mapping.triangulation import triangulate_views

CAMERA = Camera(1600, 1200, 1400.0, 1400.0, 799.5, 599.5)
MIDDLE = np.array([CAMERA.cx, CAMERA.cy])
TURN = np.array([0.001, 0.01, 0.0])
FRAMES = 6
SIGN = np.array([3.5, -1.0, 16.0])  # in the last camera
RAY_SIGMA = 0.15 / CAMERA.fx


def pixels(pose, points):
    local = pose.to_camera(points)
    return local[:, :2] / local[:, 2:] * CAMERA.fx + MIDDLE, local[:, 2]


def drive(noise_px=0.08, wrong_step=None, shuttle=0.0, sliding=0, seed=0):
    """Frames of a drive with ties, as the tracker holds them, and their true poses.

    `wrong_step`: a step whose direction is off by a fifth of a degree. `shuttle`: metres a step by which a vehicle, a
    tenth of the ties, moves sideways. `sliding`: number of ties a step that are off by 3 px and known to slide.
    """
    rng = np.random.default_rng(seed)
    held, true, chained = [], [Pose(np.eye(3), np.zeros(3))], Pose(np.eye(3), np.zeros(3))
    low, high = [-30, -6, 10], [30, 1.8, 100]
    points = rng.uniform(low, high, (3000, 3))
    vehicle = np.zeros((3000, 3))
    vehicle[::10, 0] = shuttle
    for k in range(FRAMES):
        motion = Motion(chained, None, None, "start", 0.0, 8.0 * k, None, 0.1, 0.1, True, 1, 1.6)
        if k:
            turn = Rotation.from_rotvec(rng.normal(0, 0.002, 3) + TURN).as_matrix()
            step = Pose(turn, np.array([0.05, 0.01, 8.0]))
            true.append(true[-1].compose(step))
            length = np.linalg.norm(step.centre)
            off = step.centre + np.array([0.028 if k == wrong_step else 0.0, 0, 0])
            measured = Pose(step.rotation, off / np.linalg.norm(off) * length)
            chained = chained.compose(measured)
            shown = [pixels(true[j], points + j * vehicle) for j in (k - 1, k)]
            seen = [((u > 0) & (u < [1600, 1200])).all(axis=1) & (d > 4) for u, d in shown]
            rows = np.flatnonzero(seen[0] & seen[1])
            growth = (shown[0][1] / shown[1][1])[rows]
            current = shown[1][0][rows] + rng.normal(0, noise_px, (len(rows), 2))
            current[:sliding] += [3.0, -3.0]
            ties = Ties(
                shown[0][0][rows],
                current,
                np.ones(len(rows), bool),
                true[-1].to_camera(points[rows]) * rng.normal(1, 0.03, (len(rows), 1)),
                np.column_stack([rows, rows]),
                np.column_stack([growth, 0 * growth, growth]),
                np.where(np.arange(len(rows)) < sliding, 0.5, 0.0),
            )
            ahead, loose = np.array([0.0, 0.0, 1.0]), np.array([0.01, 0.01])
            prior = StepPrior(np.eye(3), np.inf, ahead, loose, True, float(length), 0.02)
            motion = replace(motion, pose=chained, step=measured, ties=ties, prior=prior)
        frame = SimpleNamespace(index=len(held))
        held.append(SimpleNamespace(frame=frame, camera=CAMERA, motion=motion, focal=CAMERA.fx))
    return held, true


def observed_by(true, seed=0):
    """The panel of the sign as its views show it."""
    rng, last = np.random.default_rng(100 + seed), true[-1]
    rays = np.array(
        [(pixels(p, last.to_world(SIGN)[None])[0][0] - MIDDLE) / CAMERA.fx for p in true]
    )
    rays += rng.normal(0, RAY_SIGMA, rays.shape)
    sigma = np.full(len(true), RAY_SIGMA)
    return SimpleNamespace(frames=np.arange(len(true)), rays=rays, ray_sigma=sigma)


class Scene:
    """A drive, the rays to its sign, and where the chained motion places it."""

    def __init__(self, seed=0, **how):
        self.held, self.true = drive(seed=seed, **how)
        self.observed = observed_by(self.true, seed)
        poses = [h.motion.pose for h in self.held]
        place = (np.stack([getattr(p, name) for p in poses]) for name in ("rotation", "centre"))
        self.start, _ = triangulate_views(*place, self.observed.rays, self.observed.ray_sigma)
        self.observed.point = self.start

    def adjusted(self):
        """Adjusted with the last frame as the one it is reported in."""
        return adjust_jointly(self.held, FRAMES - 1, self.observed)

    def error(self, point=None):
        """Error (3,) of a place, or of the adjusted one, in the last frame."""
        place = self.adjusted().point if point is None else point
        return self.held[-1].motion.pose.to_camera(place) - SIGN

    def change_ties(self, change, frames=range(1, FRAMES)):
        for k in frames:
            motion = self.held[k].motion
            self.held[k].motion = replace(motion, ties=change(motion.ties))


def test_the_residual_is_known_before_and_after_with_the_place():
    scene = Scene(wrong_step=3)
    found = scene.adjusted()
    told = found.residual
    assert (told.first_frame, told.last_frame) == (0, FRAMES - 1)
    assert told.history_sigmas[0] > 2 * told.history_sigmas[-1]
    np.testing.assert_array_equal(told.start, scene.start)
    np.testing.assert_array_equal(told.position, found.point)


@pytest.mark.parametrize("wrong_step", [1, 3, 5])
def test_a_step_that_disagrees_with_its_neighbours_is_solved_again(wrong_step):
    scene = Scene(wrong_step=wrong_step)
    assert np.linalg.norm(scene.error()) < 0.06
    if wrong_step == 5:
        assert np.linalg.norm(scene.error(scene.start)) > 0.12


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariance_says():
    pulls = []
    for seed in range(25):
        scene = Scene(seed)
        joint = scene.adjusted()
        turn = scene.held[-1].motion.pose.rotation
        sigma = np.sqrt(np.diag(turn.T @ joint.covariance @ turn))
        pulls.append(scene.error(joint.point) / sigma)
    # errors that neighbours share are allowed for, though there are none here
    assert (np.abs(pulls) < 1).mean() > 0.6
    assert (np.abs(pulls) < 2).mean() > 0.92


def test_steps_whose_ties_scatter_make_the_place_uncertain():
    scene = Scene()
    stated = scene.adjusted().covariance
    scene.change_ties(lambda ties: replace(ties, scatter=4.0))
    # the rays of the landmark are as exact as before, and so is the known length of the steps
    assert 1.3 < np.sqrt(np.trace(scene.adjusted().covariance) / np.trace(stated)) < 4.0


def test_a_step_whose_ties_scatter_gives_way_to_its_neighbours():
    scene = Scene(wrong_step=5)
    scene.change_ties(lambda ties: replace(ties, current=ties.current + np.array([0.0, 1.0])), [5])
    trusted = scene.error()
    scene.change_ties(lambda ties: replace(ties, scatter=10.0), [5])
    assert abs(scene.error()[1]) < 0.5 * abs(trusted[1])


def test_ties_on_a_vehicle_lose_their_weight(monkeypatch):
    scene = Scene(shuttle=0.15)
    robust = np.linalg.norm(scene.error())
    assert robust < 0.08
    monkeypatch.setattr(local_adjustment, "TIE_SCALE", 1e3)
    assert np.linalg.norm(scene.error()) > 3 * robust


def test_patches_that_slide_along_their_edges_do_not_count():
    scene = Scene(sliding=60)
    before = scene.error()

    def steady(ties):
        columns = [field.name for field in fields(ties) if field.name != "scatter"]
        return replace(ties, **{n: getattr(ties, n)[ties.sigma_px == 0] for n in columns})

    scene.change_ties(steady)
    np.testing.assert_array_equal(scene.error(), before)
    assert np.linalg.norm(before) < 0.06


def test_without_ties_the_known_steps_remain():
    scene = Scene()
    scene.change_ties(lambda ties: None)
    joint = scene.adjusted()
    assert np.isfinite(joint.point).all()
    assert np.isfinite(joint.covariance).all()


def test_the_place_is_left_to_the_chain_where_the_window_says_too_little(monkeypatch):
    scene = Scene()
    all_views, known = scene.observed, scene.held[3].motion
    columns = {name: column[-1:] for name, column in vars(all_views).items() if name != "point"}
    scene.observed = SimpleNamespace(**columns, point=all_views.point)
    assert scene.adjusted() is None
    scene.observed = all_views
    scene.held[3].motion = replace(known, prior=None)
    assert scene.adjusted() is None
    scene.held[3].motion = known
    monkeypatch.setattr(local_adjustment, "MOST_FRAMES", 2)
    assert scene.adjusted() is None  # misses most of the views


@pytest.mark.parametrize(
    ("best", "views", "window"),
    [(9, [2, 5, 9], (2, 9)), (9, [0, 1, 5, 9], (5, 9)), (3, [2, 4], (2, 4))],
)
def test_the_window_holds_the_best_frame_and_the_nearest_views(best, views, window):
    assert window_around(best, np.array(views), MOST_FRAMES) == window
