"""Crops and targets of the detection network: where faces are, what is known of the rest."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from training import face_compositing
from training.camera_effects import make_noise
from training.detector_crops import (
    CROP_PX,
    KNOWN,
    STRIDE,
    UNKNOWN,
    UNSURE,
    drawn_crop,
    targets,
)
from training.detector_images import BACK, FRONT, labelled_image
from training.distractor_drawings import SLANTED, draw_distractor
from training.face_compositing import blend, draw_faces, wear
from training.face_drawings import FaceDrawing, FaceLibrary
from wayside.schemas.detections import COLORS, NONE, SHAPES

CELLS = CROP_PX // STRIDE
NOISE = make_noise(np.random.default_rng(0))


def image(faces=(), ignored=(), complete=True, size=(400, 500), other=()):
    rgb = np.full((*size, 3), 90, np.uint8)
    for box, *_ in faces:
        x0, y0, x1, y1 = (round(v) for v in box)
        rgb[y0:y1, x0:x1] = (250, 200, 20)
    return labelled_image(
        "set",
        "one",
        rgb,
        faces,
        ignored,
        fronts_complete=complete,
        backs_complete=False,
        other=other,
    )


def crop_of(faces=(), ignored=(), complete=True, other=()):
    return targets(image(faces, ignored, complete, (CROP_PX, CROP_PX), other))


def make_crop(images, probability, faces, noise, rng):
    """A crop of one of the images, drawn by `probability`, as the processes make it."""
    shown = images[int(rng.choice(len(images), p=probability))]
    return targets(drawn_crop(shown, faces, noise, rng))


def library(shape="rectangle"):
    rgba = np.zeros((64, 64, 4), np.uint8)
    rgba[4:60, 4:60] = (20, 80, 200, 255)
    face = FaceDrawing(rgba, COLORS.index("blue"), SHAPES.index(shape))
    return FaceLibrary((face,), (face,))


def test_the_heat_peaks_at_the_cell_of_the_middle_and_its_cells_hold_the_box():
    crop = crop_of([((100, 60, 140, 80), FRONT, "yellow", "diamond")])
    row, column = np.unravel_index(crop.heat[FRONT].argmax(), (CELLS, CELLS))
    assert (row, column) == (17, 30)
    assert crop.heat[FRONT].max() == 1
    assert crop.heat[BACK].max() == 0
    used = crop.weight > 0
    assert used.any()
    assert crop.weight.sum() == pytest.approx(1)
    np.testing.assert_allclose(crop.box[used], [[100, 60, 140, 80]] * used.sum())
    assert set(crop.color[used]) == {COLORS.index("yellow")}
    assert (crop.color[~used] == NONE).all()


def test_a_back_has_its_own_heat_map():
    crop = crop_of([((100, 60, 140, 100), BACK, None, None)])
    assert crop.heat[BACK].max() == 1
    assert crop.heat[FRONT].max() == 0
    assert (crop.cell[crop.weight > 0] >= CELLS * CELLS).all()
    assert (crop.color == NONE).all()


def test_two_faces_weigh_the_same_however_many_cells_they_have():
    crop = crop_of(
        [
            ((10, 10, 190, 190), FRONT, "white", "circle"),
            ((200, 200, 210, 210), FRONT, "red", "octagon"),
        ]
    )
    large = crop.box[:, 2] == 190
    assert crop.weight[large].sum() == pytest.approx(1)
    assert crop.weight[~large].sum() == pytest.approx(1)


def test_what_is_off_the_boxes_is_known_only_where_the_labels_are_complete():
    face = [((100, 100, 140, 140), FRONT, "white", "circle")]
    assert (crop_of(face).doubt[FRONT] == KNOWN).all()
    incomplete = crop_of(face, [(40, 40, 80, 80)], complete=False)
    assert incomplete.doubt[FRONT, 0, 0] == UNSURE
    assert incomplete.doubt[FRONT, 15, 15] == UNKNOWN
    assert (incomplete.doubt[:, 25:35, 25:35] == KNOWN).all()


def test_what_is_labelled_as_no_sign_is_known_to_be_none_where_the_labels_are_incomplete():
    crop = crop_of(complete=False, other=[(40, 40, 80, 80), (250, -20, 300, 10)])
    assert (crop.doubt[:, 10:20, 10:20] == KNOWN).all()
    assert (crop.doubt[:, :2, 63] == KNOWN).all()
    assert crop.doubt[FRONT, 30, 30] == UNSURE
    assert crop.heat.max() == 0


def test_crops_are_cut_around_what_is_labelled_as_no_sign():
    images = [image(complete=False, size=(900, 1200), other=[(600, 300, 630, 320)])]
    empty = FaceLibrary((), ())
    known = [
        (make_crop(images, np.ones(1), empty, NOISE, np.random.default_rng(seed)).doubt == KNOWN)
        for seed in range(20)
    ]
    assert sum(cells.any() for cells in known) > 12


def test_some_crops_are_as_taken():
    images, empty = [image()], FaceLibrary((), ())
    crops = [
        make_crop(images, np.ones(1), empty, NOISE, np.random.default_rng(seed)).rgb
        for seed in range(60)
    ]
    plain = [(rgb == 90).all(axis=2).mean() > 0.3 for rgb in crops]
    assert 8 < sum(plain) < 40


@pytest.mark.parametrize("box", [(100, 100, 104, 104), (-60, 100, 20, 180)])
def test_faces_that_are_too_small_or_hardly_in_the_crop_are_neither(box):
    crop = crop_of([(box, FRONT, "white", "circle")])
    assert crop.weight.sum() == 0
    x, y = max(box[0], 1) // STRIDE, (box[1] + box[3]) // 2 // STRIDE
    assert crop.doubt[FRONT, y, x] == UNKNOWN


def test_the_same_seed_gives_the_same_crop_and_another_one_another():
    images = [image([((200, 150, 260, 210), FRONT, "yellow", "diamond")]), image()]
    one, same, other = (
        make_crop(images, np.array([0.5, 0.5]), library(), NOISE, np.random.default_rng(seed))
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(one.rgb, same.rgb)
    np.testing.assert_array_equal(one.box, same.box)
    assert (one.rgb != other.rgb).any()


def test_boxes_follow_their_faces_through_scale_and_mirror():
    images = [image([((200, 150, 260, 210), FRONT, "yellow", "diamond")])]
    empty = FaceLibrary((), ())
    seen = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        crop = make_crop(images, np.array([1.0]), empty, NOISE, rng)
        for box in crop.box[crop.weight > 0]:
            if box[3] - box[1] > 20 and crop.rgb.std() > 5:
                x0, y0, x1, y1 = box.astype(int)
                inside = crop.rgb[y0 + 4 : y1 - 4, x0 + 4 : x1 - 4].astype(float).mean(axis=(0, 1))
                assert inside.max() - inside.min() > 0
                seen += 1
    assert seen > 10


def test_drawn_faces_change_the_image_inside_their_boxes_and_spare_what_is_taken():
    taken = np.array([[0, 0, 256, 120]], np.float32)
    for seed in range(20):
        rgb = np.full((256, 256, 3), 90, np.uint8)
        drawn = draw_faces(rgb, taken, library(), NOISE.smooth, np.random.default_rng(seed), 3)
        assert (rgb[:118] == 90).all()
        for face in drawn:
            x0, y0, x1, y1 = (int(v) for v in face.box)
            assert (rgb[y0:y1, x0:x1] != 90).any()
            assert 0 <= x0 < x1 <= 256


def test_faces_that_touch_are_of_one_kind_and_width_and_seen_from_one_angle(monkeypatch):
    monkeypatch.setattr(face_compositing, "TOUCHING", 1.0)
    widths, gaps, shapes = [], [], []
    for seed in range(60):
        rgb = np.full((256, 256, 3), 90, np.uint8)
        none, rng = np.zeros((0, 4), np.float32), np.random.default_rng(seed)
        faces = draw_faces(rgb, none, library("circle"), NOISE.smooth, rng, 1)
        whole = [face.box for face in faces if 0 < face.box[0] and face.box[2] < 256]
        for above, below in pairwise(whole):
            if below[1] > above[1]:  # not side by side
                widths.append((below[2] - below[0]) / (above[2] - above[0]))
                gaps.append(below[1] - above[3])
                shapes.append({face.shape for face in faces})
    assert len(gaps) > 20
    # boards are rectangles, crossbucks of their own shape
    assert all(len(kinds) == 1 for kinds in shapes)
    assert len({*map(tuple, shapes)}) > 1
    # a face that leans is wider by its height
    assert np.quantile(widths, [0.2, 0.8]) == pytest.approx(1, abs=0.1)
    assert np.quantile(gaps, [0.2, 0.8]) == pytest.approx(0, abs=2.5)


def test_distractors_change_the_image_inside_their_boxes_and_spare_what_is_taken():
    taken = np.array([[0, 0, 256, 120]], np.float32)
    boxes = 0
    for seed in range(60):
        rgb = np.random.default_rng(seed).integers(0, 256, (256, 256, 3)).astype(np.uint8)
        before = rgb.copy()
        box = draw_distractor(rgb, taken, NOISE.smooth, np.random.default_rng(seed))
        changed = (rgb != before).any(axis=2)
        assert not changed[:118].any()
        if box is not None:
            x0, y0, x1, y1 = (int(v) for v in box)
            assert changed[y0:y1, x0:x1].mean() > 0.1
            # light of bright things spreads by the blur of the lens
            changed[max(0, y0 - 4) : y1 + 4, max(0, x0 - 4) : x1 + 4] = False
            assert not changed.any()
            boxes += 1
    assert boxes > 10


def test_some_distractors_touch_a_face():
    face, touching, apart = (110.0, 100.0, 140.0, 130.0), 0, 0
    for seed in range(80):
        rgb = np.full((256, 256, 3), 90, np.uint8)
        taken, rng = np.array([face], np.float32), np.random.default_rng(seed)
        box = draw_distractor(rgb, taken, NOISE.smooth, rng)
        if box is not None:
            ends = np.array(
                [face[0] - box[2], box[0] - face[2], face[1] - box[3], box[1] - face[3]]
            )
            touching, apart = touching + (ends.max() < 8), apart + (ends.max() >= 8)
    assert min(touching, apart) > 15


def test_letters_of_advertisements_lean_and_those_of_boards_do_not():
    """OpenCV draws most of its named typefaces alike: an advertisement in one of those is a board."""

    def lean(typeface):
        page = np.zeros((80, 60), np.uint8)
        cv2.putText(page, "I", (20, 70), typeface, 2.5, 255, 4, cv2.LINE_AA)
        rows = np.flatnonzero(page.any(axis=1))
        top, bottom = (np.flatnonzero(page[row] > 128).mean() for row in rows[[8, -8]])
        return top - bottom

    assert min(map(lean, SLANTED)) > 4
    assert abs(lean(cv2.FONT_HERSHEY_SIMPLEX)) < 2


def test_what_is_drawn_as_no_sign_is_known_to_be_none():
    incomplete, empty = image(complete=False), FaceLibrary((), ())
    drawn = [
        drawn_crop(incomplete, empty, NOISE, np.random.default_rng(seed)).other
        for seed in range(20)
    ]
    assert sum(map(len, drawn)) > 5


def test_a_board_in_the_sun_loses_thin_lines_and_keeps_its_edge(monkeypatch):
    """White of three times the range beside a line of a tenth of it: the blur of the lens fills the line."""
    monkeypatch.setattr(face_compositing, "LENS_PX", (1.0, 1.0))
    patch = np.zeros((40, 60, 4), np.float32)
    patch[4:36, 4:56] = (0.85, 0.85, 0.85, 1)
    patch[4:36, 20, :3] = patch[4:36, 30:50, :3] = 0.05
    shown = {}
    for light in (1.0, 6.0):
        worn, rgb = patch.copy(), np.full((40, 60, 3), 60, np.uint8)
        wear(worn, FRONT, light, rgb, (0, 0, 60, 40), 0 * NOISE.smooth, np.random.default_rng(3))
        box = blend(rgb, worn, 0, 0)
        assert box == pytest.approx((4, 4, 56, 36), abs=1)
        shown[light] = rgb[10:30].mean(axis=(0, 2))
    assert shown[1.0][20] < 0.4 * shown[1.0][12]
    assert shown[6.0][20] > 0.9 * shown[6.0][12]
    assert shown[6.0][40] < 0.6 * shown[6.0][12]
