import numpy as np

from wayside.pipeline.learning.samples import TrueFaces, labelled, read_box_features, read_patches
from wayside.schemas.detections import Regions
from wayside.schemas.frame import USED, Camera, Frame, Image
from wayside.stages.detection.detector import box_feature_names

CAMERA = Camera(100, 80, 90.0, 90.0, 49.5, 39.5)


def plain(index, grey):
    rgb = np.full((80, 100, 3), grey, np.uint8)
    return Image(Frame(index, index, None, USED, "jpeg", b"", CAMERA), rgb, rgb[..., 0])


def candidates(frames):
    n = len(frames)
    regions = Regions(
        np.tile(np.array([[20, 20, 60, 50]], np.float32), (n, 1)),
        np.full(n, 50, np.int32),
        np.full((n, 3), 90, np.float32),
        np.zeros(n, np.uint8),
    )
    true_faces = TrueFaces(
        np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros(0, bool), np.ones(2, bool)
    )
    return labelled(regions, np.array(frames, np.int32), true_faces)


def test_what_boxes_show_comes_in_the_order_of_the_boxes_not_of_the_images():
    images, asked = [plain(0, 30), plain(1, 200)], candidates([1, 0, 1, 0])
    assert read_patches(images, asked)[:, 16, 16, 0].tolist() == [200, 30, 200, 30]
    bright = read_box_features(images, asked)[
        :, box_feature_names().index("inside_mean_brightness")
    ]
    assert bright[0] == bright[2] > bright[1] == bright[3]


def test_boxes_of_images_that_are_missing_show_nothing():
    assert not read_patches([plain(0, 30)], candidates([1])).any()
