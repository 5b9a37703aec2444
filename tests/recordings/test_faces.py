"""What the renderer paints: faces in the colours that the truth states, and what a sensor makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("foxglove_schemas_protobuf", reason="needs: pip install -e '.[drives]'")

from recordings.drives.camera import CameraModel
from recordings.drives.sensor import Exposure, Sensor
from recordings.drives.signs.catalogue import GROUPS
from recordings.drives.signs.face import COLORS
from recordings.drives.signs.invented import invented
from recordings.drives.spec import CameraSpec, DriveSpec, SensorSpec
from wayside.schemas.detections import COLORS as SIGN_COLORS


def share_of(face, color):
    pixels = face.image[face.alpha() > 127].astype(np.int64)
    packed, count = np.unique(pixels @ (1 << 16, 1 << 8, 1), return_counts=True)
    colors = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=1)
    sheeting = np.array(list(COLORS.values()))
    nearest = np.concatenate(
        [((some[:, None] - sheeting) ** 2).sum(2).argmin(1) for some in np.array_split(colors, 20)]
    )
    return float(count[nearest == list(COLORS).index(color)].sum() / count.sum())


@pytest.mark.parametrize("group", GROUPS)
def test_every_group_paints_faces_of_a_sign_colour_that_is_on_them(group):
    for seed in range(3):
        for face, gap in GROUPS[group](np.random.default_rng(seed)):
            assert face.color in SIGN_COLORS
            assert gap >= 0
            assert share_of(face, face.color) > 0.2
            assert set(face.secondary) <= set(COLORS)


@given(st.integers(0, 2**32))
@pytest.mark.slow
def test_no_part_of_an_invented_face_is_larger_than_that_of_its_colour(seed):
    face = invented(np.random.default_rng(seed))
    own = share_of(face, face.color)
    # counted on every fifth row there, on all of them here
    assert all(share_of(face, other) < own + 0.1 for other in face.secondary)


def developed(sensor, light):
    camera = CameraSpec(width=32, height=24, fx=30.0, fy=30.0, cx=15.5, cy=11.5)
    bare = replace(sensor, vignette=0.0, blur_px=0.0, motion_blur_px=0.0, noise=0.0, sharpen=0.0)
    spec = DriveSpec("plain", 1, 1, camera=camera, sensor=bare)
    lens = CameraModel(camera)
    canvas = np.empty((lens.canvas_height, lens.canvas_width, 3), np.float32)
    canvas[:] = light
    return Sensor(spec, lens).develop(canvas, 0, Exposure(1.0, (1.0, 1.0, 1.0)))


def test_a_mosaic_leaves_an_even_colour_as_it_is():
    color = np.array([0.4, 0.2, 0.1], np.float32)
    plain, mosaic = (developed(SensorSpec(mosaic=on), color) for on in (False, True))
    assert np.abs(plain.astype(int) - mosaic).max() <= 1


def test_contrast_deepens_shadows_and_lifts_highlights_about_a_middle_grey():
    dark, middle, bright = (
        [int(developed(SensorSpec(contrast=c), light).mean()) for c in (1.0, 1.5)]
        for light in (0.05, 0.25, 0.6)
    )
    assert dark[1] < dark[0] - 10
    assert abs(middle[1] - middle[0]) <= 1
    assert bright[1] > bright[0] + 10
