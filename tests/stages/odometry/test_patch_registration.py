import cv2
import numpy as np
import pytest

from wayside.stages.odometry.patch_registration import register_patches

SHIFT = np.array([3.3, -2.4])


@pytest.fixture(scope="module")
def far():
    noise = np.random.default_rng(0).random((400, 500)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return cv2.normalize(blurred, None, 20, 235, cv2.NORM_MINMAX).astype(np.uint8)


def seen_nearer(far, scale, gain=0.8, bias=10.0, noise=1.0):
    warp = np.array([[scale, 0, SHIFT[0]], [0, scale, SHIFT[1]]])
    size = int(500 * scale), int(400 * scale)
    near = cv2.warpAffine(far, warp, size, flags=cv2.INTER_CUBIC).astype(np.float64)
    near += np.random.default_rng(1).normal(0, noise, near.shape)
    return np.clip(gain * near + bias, 0, 255).astype(np.uint8)


def somewhere(count=250):
    return np.random.default_rng(2).integers((40, 40), (440, 340), (count, 2))


def register(far, near, corners, starts=None, warps=None):
    starts = corners.astype(float) if starts is None else starts
    warps = plates(len(corners)) if warps is None else warps
    return register_patches(far, near, corners, starts, warps, 2)


def plates(count, scale=1.0):
    """Warps of things that face the camera."""
    return np.tile([scale, 0.0, scale], (count, 1))


@pytest.mark.parametrize("scale", [1.0, 1.15, 1.6])
def test_patches_are_found_to_a_twentieth_of_a_pixel_in_spite_of_scale_gain_and_bias(far, scale):
    corners, near = somewhere(), seen_nearer(far, scale)
    truth = corners * scale + SHIFT
    starts = truth + np.random.default_rng(3).uniform(-2, 2, truth.shape)
    found = register(far, near, corners, starts, plates(len(corners), scale * 0.95))
    assert (found.zncc > 0.95).mean() > 0.95
    good = found.zncc > 0.95
    assert np.sqrt(((found.point - truth)[good] ** 2).mean()) < 0.05
    np.testing.assert_allclose(found.scale[good], 1 / 0.95, rtol=0.03)


def test_a_road_seen_nearer_is_placed_better_by_its_own_warp_than_by_that_of_a_plate(far):
    warp = np.array([[1.4, 0.25, -60.0], [0.0, 1.9, -200.0]])
    near = cv2.warpAffine(far, warp, (640, 520), flags=cv2.INTER_CUBIC)
    corners = np.random.default_rng(2).integers((80, 130), (380, 340), (60, 2))
    truth = corners @ warp[:, :2].T + warp[:, 2]
    starts = np.round(truth) + 1.0
    flat = np.tile([1.4, 0.25, 1.9], (60, 1))
    found = register(far, near, corners, starts, flat)
    upright = register(far, near, corners, starts, plates(60, 1.6))
    off, off_upright = (np.nanmedian(np.abs(f.point - truth)) for f in (found, upright))
    assert (found.zncc > 0.95).mean() > 0.9
    assert off < 0.05
    assert off_upright > 4 * off


def test_patches_without_texture_at_the_rim_or_searched_nowhere_are_refused(far):
    flat = np.full_like(far, 90)
    middle, rim = np.array([[200, 200]]), np.array([[3, 200], [499, 399], [200, 5]])
    assert register(flat, flat, middle).zncc[0] == 0
    found = register(far, far, rim)
    assert (found.zncc == 0).all()
    assert np.isnan(found.point).all()
    starts = np.array([[np.nan, 200], [np.inf, 200], [-300.0, 200], [200, 9000.0]])
    assert (register(far, far, middle.repeat(4, 0), starts).zncc == 0).all()


def test_another_scene_is_not_taken_for_the_patch(far):
    assert (register(far, np.ascontiguousarray(far[::-1, ::-1]), somewhere()).zncc < 0.85).all()


def test_colour_images_are_refused(far):
    with pytest.raises(ValueError, match="far"):
        register(np.dstack([far] * 3), far, somewhere(1))


def test_sigma_is_the_scatter_of_corners_under_noise(far):
    corners = somewhere(40)
    gaps, stated = [], []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0, 6.0, far.shape)
        found = register(far, np.clip(far + noise, 0, 255).astype(np.uint8), corners)
        gaps.append(found.point - corners)
        stated.append(found.sigma)
    scatter = np.std(gaps, axis=0).max(axis=1)
    assert np.median(np.mean(stated, axis=0) / scatter) == pytest.approx(1.1, abs=0.3)


def test_a_patch_on_an_edge_may_slide_and_one_on_a_corner_may_not(far):
    image = np.full((120, 200), 60, np.float64)
    image[:, 50:60] = 180.0  # a marking
    image[80:, 140:] = 180.0  # a corner
    image += np.random.default_rng(0).normal(0, 2.0, image.shape)
    other = image + np.random.default_rng(1).normal(0, 2.0, image.shape)
    both = [cv2.GaussianBlur(p, (0, 0), 1.0).round().astype(np.uint8) for p in (image, other)]
    found = register(*both, np.array([[50, 60], [140, 80]]))
    assert found.sigma[0] > 5 * found.sigma[1]
