"""The stage as a whole: table, rows, states of frames, repeatability."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import ndimage

from wayside.schemas.detections import SOURCES
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import THINNED, Camera
from wayside.schemas.settings import GateSettings, SegmentSettings
from wayside.stages.segmentation.two_pass import band_of, segment

from ..made_frames import made_image

SETTINGS = SegmentSettings()
GATE = GateSettings(smallest_px=20, largest_px=20_000)


def image(height=150, width=200, seed=0, signs=True, camera=None):
    rng = np.random.default_rng(seed)
    rgb = np.empty((height, width, 3))
    rgb[: height // 2], rgb[height // 2 :] = (150, 180, 220), (80, 85, 90)
    rgb += 12 * cv2.GaussianBlur(rng.normal(size=rgb.shape), (0, 0), 2)
    if signs:
        rgb[60:80, 90:110] = (230, 190, 30)
        rgb[62:75, 30:50] = (180, 30, 40)
    rgb = np.clip(rgb + rng.normal(0, 2, rgb.shape), 0, 255).astype(np.uint8)
    return made_image(rgb, camera=camera)


def one(given, settings=SETTINGS, gate=GATE):
    (result,) = segment(iter([given]), settings, gate)
    return result


def rows_of(result, source):
    return result.regions.select(result.regions.source == SOURCES.index(source))


def test_all_regions_of_both_label_images_are_counted_and_the_gate_bounds_the_rows():
    result = one(image())
    total = sum(
        ndimage.label(labels == label)[1] for labels in result.labels for label in np.unique(labels)
    )
    assert result.region_count == total
    assert result.dropped == (total - len(result.regions), 0)
    areas = result.regions.area_px
    assert areas.min() >= 20
    assert areas.max() <= 20_000


def test_labels_are_nearest_colours_and_classes_of_the_distance_to_them():
    given = image()
    result = one(given)
    gap = given.rgb[:, :, None].astype(int) - result.palette.astype(int)
    squared = (gap**2).sum(axis=-1)
    np.testing.assert_array_equal(result.labels[0], squared.argmin(axis=-1))
    difference = np.floor(np.sqrt(squared.min(axis=-1)) + 0.5)
    levels = result.difference_levels
    np.testing.assert_array_equal(
        result.labels[1], np.searchsorted(levels[1:], difference, side="right")
    )


@pytest.mark.parametrize("clusters", [2, 3, 7, 16, 40])
def test_k_of_both_passes_is_as_set(clusters):
    settings = replace(SETTINGS, clusters=clusters, difference_clusters=43 - clusters)
    result = one(image(), settings)
    assert len(result.palette) == clusters
    assert len(result.difference_levels) == 43 - clusters
    assert result.labels[0].max() < clusters


CAMERA = Camera(200, 150, 150.0, 150.0, 100.0, 75.0)


def test_the_band_is_segmented_as_rows_of_the_full_image():
    given = image(camera=CAMERA)
    result = one(given)
    first, last = result.rows
    assert 0 < first < 60 < 80 < last < 150
    assert result.labels[0].shape == (last - first, 200)
    assert result.regions.box[:, 1].min() >= first
    assert result.regions.box[:, 3].max() <= last
    table = result.regions
    for (x0, y0, x1, y1), area, rgb in zip(
        table.box.astype(int), table.area_px, table.rgb, strict=True
    ):
        inside = given.rgb[y0:y1, x0:x1].reshape(-1, 3)
        assert area <= len(inside)
        assert (inside.min(axis=0) <= rgb).all()
        assert (rgb <= inside.max(axis=0)).all()


def test_the_band_covers_road_signs_seen_from_a_level_camera():
    first, last = band_of(Camera(1600, 1200, 1400.0, 1400.0, 800.0, 600.0), 1200)
    for up, ahead in ((2.0, 12.0), (6.0, 35.0), (-1.0, 12.0)):
        assert first <= 600 - 1400 * up / ahead < last
    assert last - first < 800


def test_a_camera_that_looks_away_or_is_unknown_gets_the_whole_image():
    assert band_of(Camera(1600, 1200, 1400.0, 1400.0, 800.0, -5000.0), 1200) == (0, 1200)
    assert band_of(None, 1200) == (0, 1200)


def test_frames_without_pixels_travel_with_empty_tables():
    unused = made_image(image().rgb, status=THINNED)
    result = one(unused)
    assert result.image is unused
    assert (len(result.regions), result.region_count, result.rows) == (0, 0, (0, 0))
    assert result.labels is None


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (3, 2), (37, 41), (64, 1)])
def test_tiny_and_odd_images_are_segmented(size):
    result = one(image(*size, signs=False), gate=GateSettings(smallest_px=1))
    areas = [rows_of(result, source).area_px.sum() for source in ("pass1", "pass2")]
    assert areas == [size[0] * size[1]] * 2


def test_threads_side_by_side_give_the_same_bytes_as_one(bits):
    given = [image(seed=i) for i in range(6)]
    alone = list(segment(iter(given), SETTINGS, GATE))
    with ThreadPoolExecutor(2) as pool:
        both = list(pool.map(lambda _: list(segment(iter(given), SETTINGS, GATE)), range(2)))
    assert [bits(results) for results in both] == [bits(alone)] * 2


@pytest.mark.parametrize(
    "gate", [GateSettings(smallest_px=0), GateSettings(smallest_px=9, largest_px=8)]
)
def test_limits_of_the_size_that_contradict_each_other_are_refused(gate):
    with pytest.raises(UsageError, match="gate"):
        one(image(), gate=gate)


def test_a_face_whose_colour_no_cluster_has_is_found_whole_by_pass_two():
    rgb = image(signs=False).rgb.astype(float)
    rgb[60:78, 90:110] = np.array([120, 150, 120]) + np.random.default_rng(3).normal(
        0, 6, (18, 20, 3)
    )
    result = one(made_image(rgb.astype(np.uint8)), replace(SETTINGS, clusters=2))
    face = [90, 60, 110, 78]
    assert face not in rows_of(result, "pass1").box.tolist()
    assert face in rows_of(result, "pass2").box.tolist()
