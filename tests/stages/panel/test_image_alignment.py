from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from wayside.stages.panel.image_alignment import align, warp_to_template

ROWS, COLUMNS = 61, 71


def scene(seed):
    noise = np.random.default_rng(seed).normal(size=(ROWS, COLUMNS))
    return (120 + 400 * gaussian_filter(noise, 2.0)).astype(np.float32)


def moved(image, shift, stretch):
    """What shows the template's sample x at middle + shift + stretch * (x - middle)."""
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    middle = np.array([COLUMNS - 1, ROWS - 1]) / 2
    x = middle[0] + (u - middle[0] - shift[0]) / stretch[0]
    y = middle[1] + (v - middle[1] - shift[1]) / stretch[1]
    return map_coordinates(image, [y, x], np.float32, order=3, mode="nearest")


def middle_weight():
    weight = np.zeros((ROWS, COLUMNS), np.float32)
    weight[12:-12, 12:-12] = 1.0
    return weight


@settings(max_examples=20)
@given(
    seed=st.integers(0, 50),
    shift=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    stretch=st.tuples(st.floats(0.95, 1.05), st.floats(0.95, 1.05)),
    gain=st.floats(0.7, 1.4),
)
# the shift is right at once
@example(seed=11, shift=(0.0, 0.0), stretch=(1.03125, 0.953125), gain=1.375)
def test_shift_and_stretch_are_found_whatever_the_light(seed, shift, stretch, gain):
    template = scene(seed)
    patch = moved(template, shift, stretch) * gain + 7.0
    found = align(template, middle_weight(), patch, np.round(shift))
    assert found is not None
    np.testing.assert_allclose(found.shift, shift, atol=0.02)
    np.testing.assert_allclose(found.stretch, stretch, atol=0.002)
    assert found.gain == pytest.approx(1 / gain, rel=0.06)  # bilinear sampling smooths
    assert found.zncc > 0.99


def test_a_view_of_coarse_pixels_is_aligned_to_where_it_fits_best():
    template = 255 * np.random.default_rng(0).random((12, 12), np.float32).repeat(5, 0).repeat(5, 1)
    coarse = cv2.resize(template, (24, 24), interpolation=cv2.INTER_AREA)
    patch = cv2.resize(coarse, (60, 60), interpolation=cv2.INTER_LINEAR)
    found = align(template, np.pad(np.ones((36, 36), np.float32), 12), patch, np.zeros(2))
    assert found is not None
    np.testing.assert_allclose(found.shift, 0, atol=0.02)


def test_the_covariance_grows_with_noise():
    template = scene(1)
    rng = np.random.default_rng(2)
    noisy = [template + s * rng.standard_normal(template.shape, np.float32) for s in (2, 10)]
    little, much = (align(template, middle_weight(), one, np.zeros(2)) for one in noisy)
    assert np.trace(much.covariance) > 4 * np.trace(little.covariance)


def test_what_is_unlike_or_shows_nothing_is_not_aligned():
    other = align(scene(1), middle_weight(), scene(2), np.zeros(2))
    assert other is None or other.zncc < 0.6
    flat = np.full((ROWS, COLUMNS), 50.0, np.float32)
    assert align(flat, middle_weight(), flat.copy(), np.zeros(2)) is None
    assert align(scene(1), 0 * middle_weight(), scene(1), np.zeros(2)) is None
    with pytest.raises(ValueError, match="patch"):
        align(scene(1), middle_weight(), scene(1)[:-1], np.zeros(2))


def test_a_view_is_drawn_as_the_template_sees_it():
    template = scene(3)
    patch = moved(template, (1.3, -0.7), (1.03, 0.98)) * 0.8 + 5
    found = align(template, middle_weight(), patch, np.zeros(2))
    assert found is not None
    view = cv2.cvtColor(patch.astype(np.float32), cv2.COLOR_GRAY2BGR)
    drawn = warp_to_template(view, found)[..., 0]
    inside = (slice(12, -12), slice(12, -12))
    assert np.abs(drawn[inside] - template[inside]).mean() < 2.0


@pytest.mark.slow
def test_the_process_that_compiles_finds_the_same_bits_as_those_that_load_kernels(python, tmp_path):
    program = """
import numpy as np
from test_image_alignment import align, middle_weight, moved, scene
for seed in range(9):
    patch = moved(scene(seed), (0.7, -1.2), (1.02, 0.97)) + np.float32(3 * seed)
    found = align(scene(seed), middle_weight(), patch, np.array([1.0, -1.0]))
    print(*(float(value).hex() for value in (*found.shift, *found.stretch, found.zncc)))
"""
    folders = {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(__file__).parent)}
    first, second = (python(program, **folders).stdout for _ in range(2))
    assert first.count("0x") == 45
    assert first == second
