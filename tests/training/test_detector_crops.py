"""Crops and targets of the detection network: where faces are, what is known of the rest."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from recordings.drives.signs.face import COLORS as SHEETING
from training import camera_effects, face_compositing
from training.camera_effects import make_noise, through_a_camera
from training.detector_crops import CROP_PX, KNOWN, STRIDE, UNKNOWN, UNSURE, drawn_crop, targets
from training.detector_images import BACK, FRONT, LabelledImage
from training.distractor_drawings import SLANTED, draw_distractor
from training.face_compositing import blend, draw_faces, wear
from training.face_drawings import BOARD_WEIGHTS, FaceDrawing, FaceLibrary, draw_board
from wayside.schemas.detections import COLORS, NONE, SHAPES

CELLS = CROP_PX // STRIDE
NOISE = make_noise(np.random.default_rng(0))


def image(faces=(), ignored=(), complete=True, size=(400, 500), other=()):
    rgb = np.full((*size, 3), 90, np.uint8)
    for box, *_ in faces:
        x0, y0, x1, y1 = (round(v) for v in box)
        rgb[y0:y1, x0:x1] = (250, 200, 20)
    return LabelledImage.of(("set", "one"), rgb, faces, ignored, other, (complete, False))


def crop_of(faces=(), ignored=(), complete=True, other=()):
    return targets(image(faces, ignored, complete, (CROP_PX, CROP_PX), other))


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
    assert crop.heat.max(axis=(1, 2)).tolist() == [0, 1]
    assert (crop.cell[crop.weight > 0] >= CELLS * CELLS).all()
    assert (crop.color == NONE).all()


def test_two_faces_weigh_the_same_however_many_cells_they_have():
    small = ((200, 200, 210, 210), FRONT, "red", "octagon")
    crop = crop_of([((10, 10, 190, 190), FRONT, "white", "circle"), small])
    large = crop.box[:, 2] == 190
    assert crop.weight[large].sum() == pytest.approx(1)
    assert crop.weight[~large].sum() == pytest.approx(1)


def test_what_is_off_the_boxes_is_known_only_where_labels_are_complete_or_say_so():
    face = [((100, 100, 140, 140), FRONT, "white", "circle")]
    assert (crop_of(face).doubt[FRONT] == KNOWN).all()
    other = [(180, 180, 220, 220), (250, -20, 300, 10)]
    doubt = crop_of(face, [(40, 40, 80, 80)], complete=False, other=other).doubt
    assert doubt[FRONT, 0, 0] == UNSURE
    assert doubt[FRONT, 15, 15] == UNKNOWN
    for at in (slice(25, 35), slice(45, 55)):
        assert (doubt[:, at, at] == KNOWN).all()
    assert (doubt[:, :2, 63] == KNOWN).all()


def crops(shown, seeds):
    rngs = map(np.random.default_rng, range(seeds))
    return [drawn_crop(shown, FaceLibrary((), ()), NOISE, rng) for rng in rngs]


def test_crops_are_cut_around_what_is_labelled_as_no_sign_and_some_are_as_taken():
    shown = image(complete=False, size=(900, 1200), other=[(600, 300, 630, 320)])
    assert sum((targets(crop).doubt == KNOWN).any() for crop in crops(shown, 20)) > 12
    plain = [(crop.rgb == 90).all(axis=2).mean() > 0.3 for crop in crops(image(), 60)]
    assert 8 < sum(plain) < 40


@pytest.mark.parametrize("box", [(100, 100, 104, 104), (-60, 100, 20, 180)])
def test_faces_that_are_too_small_or_hardly_in_the_crop_are_neither(box):
    crop = crop_of([(box, FRONT, "white", "circle")])
    assert crop.weight.sum() == 0
    x, y = max(box[0], 1) // STRIDE, (box[1] + box[3]) // 2 // STRIDE
    assert crop.doubt[FRONT, y, x] == UNKNOWN


def test_boxes_follow_their_faces_through_scale_and_mirror_and_the_seed_says_all():
    shown, seen = image([((200, 150, 260, 210), FRONT, "yellow", "diamond")]), 0
    one, same = crops(shown, 60), crops(shown, 60)
    for crop, again in zip(one, same, strict=True):
        np.testing.assert_array_equal(crop.rgb, again.rgb)
        np.testing.assert_array_equal(crop.box, again.box)
        for x0, y0, x1, y1 in np.clip(crop.box[:1], 0, CROP_PX).astype(int):
            if y1 - y0 > 20 and x1 - x0 > 20 and crop.rgb.std() > 5:
                inside = crop.rgb[y0 + 4 : y1 - 4, x0 + 4 : x1 - 4].astype(float)
                assert np.ptp(inside.mean(axis=(0, 1))) > 0
                seen += 1
    assert seen > 10
    assert (one[0].rgb != one[1].rgb).any()


def test_drawn_faces_change_the_image_inside_their_boxes_and_spare_what_is_taken():
    taken = np.array([[0, 0, 256, 120]], np.float32)
    for seed in range(20):
        rgb = np.full((256, 256, 3), 90, np.uint8)
        drawn = draw_faces(rgb, taken, library(), NOISE.smooth, np.random.default_rng(seed), 3)
        assert (rgb[:118] == 90).all()
        for box, _ in drawn:
            x0, y0, x1, y1 = (int(v) for v in box)
            assert (rgb[y0:y1, x0:x1] != 90).any()
            assert 0 <= x0 < x1 <= 256


def test_faces_that_touch_are_of_one_kind_and_width_and_seen_from_one_angle(monkeypatch):
    monkeypatch.setattr(face_compositing, "TOUCHING", 1.0)
    widths, gaps, shapes = [], [], []
    for seed in range(60):
        rgb = np.full((256, 256, 3), 90, np.uint8)
        none, rng = np.zeros((0, 4), np.float32), np.random.default_rng(seed)
        faces = draw_faces(rgb, none, library("circle"), NOISE.smooth, rng, 1)
        whole = [box for box, _ in faces if 0 < box[0] and box[2] < 256]
        for above, below in pairwise(whole):
            if below[1] > above[1]:  # not side by side
                widths.append((below[2] - below[0]) / (above[2] - above[0]))
                gaps.append(below[1] - above[3])
                shapes.append({face.shape for _, face in faces})
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
    left, top, right, bottom = face = (110.0, 100.0, 140.0, 130.0)
    apart = []
    for seed in range(80):
        rgb, rng = np.full((256, 256, 3), 90, np.uint8), np.random.default_rng(seed)
        box = draw_distractor(rgb, np.array([face], np.float32), NOISE.smooth, rng)
        if box is not None:
            apart.append(max(left - box[2], box[0] - right, top - box[3], box[1] - bottom))
    assert 15 < sum(gap < 8 for gap in apart) < len(apart) - 15


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
    assert sum(len(crop.other) for crop in crops(image(complete=False), 20)) > 5


def test_a_board_in_the_sun_loses_thin_lines_and_keeps_its_edge(monkeypatch):
    """White of three times the range next to a line of a tenth of it: the blur of the lens fills the line."""
    monkeypatch.setattr(face_compositing, "LENS_PX", (1.0, 1.0))
    patch = np.zeros((40, 60, 4), np.float32)
    patch[4:36, 4:56] = (0.85, 0.85, 0.85, 1)
    patch[4:36, 20, :3] = patch[4:36, 30:50, :3] = 0.05
    shown = {}
    for light in (1.0, 6.0):
        worn, rgb = patch.copy(), np.full((40, 60, 3), 60, np.uint8)
        wear(worn, FRONT, light, rgb, (0, 0, 60, 40), 0 * NOISE.smooth, np.random.default_rng(3))
        assert blend(rgb, worn, 0, 0) == pytest.approx((4, 4, 56, 36), abs=1)
        shown[light] = rgb[10:30].mean(axis=(0, 2))
    assert shown[1.0][20] < 0.4 * shown[1.0][12]
    assert shown[6.0][20] > 0.9 * shown[6.0][12]
    assert shown[6.0][40] < 0.6 * shown[6.0][12]


def boards(color, count=40):
    return [draw_board(color, np.random.default_rng(seed)) for seed in range(count)]


@pytest.mark.parametrize("color", BOARD_WEIGHTS)
def test_most_of_a_board_has_the_colour_it_is_named_by(color):
    names, hits = list(BOARD_WEIGHTS), 0
    for board in boards(color):
        shown = board[..., :3][board[..., 3] > 0].astype(int)
        away = np.stack([np.abs(shown - SHEETING[name]).sum(axis=1) for name in names])
        hits += names[np.bincount(away.argmin(axis=0)).argmax()] == color
    assert hits >= 38


def test_boards_are_opaque_but_for_their_corners_and_all_show_something():
    for board in boards("blue"):
        assert (board[..., 3] > 0).mean() > 0.9
        assert board[..., 3].any(axis=0).all()
        assert board[..., 3].any(axis=1).all()
        assert np.ptp(board[..., :3].astype(int).sum(axis=2)) > 200


def test_boards_differ_by_their_seed_and_by_nothing_else():
    first, again = boards("green", 8), boards("green", 8)
    assert all((a == b).all() for a, b in zip(first, again, strict=True))
    assert len({board.tobytes() for board in first}) == 8


def shown(rgb, seeds):
    return [through_a_camera(rgb, NOISE, np.random.default_rng(seed)) for seed in range(seeds)]


def test_a_camera_changes_the_pixels_but_not_their_number():
    rgb = np.random.default_rng(1).integers(0, 256, (256, 256, 3)).astype(np.uint8)
    for seen in shown(rgb, 30):
        assert seen.shape == rgb.shape
        assert seen.dtype == np.uint8
        assert (seen != rgb).any()


def test_the_same_seed_gives_the_same_pixels_and_leaves_the_image_as_it_was():
    rgb = np.random.default_rng(1).integers(0, 256, (128, 128, 3)).astype(np.uint8)
    before = rgb.copy()
    one, same = (through_a_camera(rgb, NOISE, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(one, same)
    np.testing.assert_array_equal(rgb, before)


def test_light_that_is_too_bright_runs_over_thin_dark_lines(monkeypatch):
    """The line is as dark as before the lens, and twice as far from the end of the range as the white around it."""
    monkeypatch.setattr(camera_effects, "TOO_BRIGHT", (1.0, 2.0, 2.4))
    rgb = np.full((64, 64, 3), 200, np.uint8)
    rgb[:, 32] = 30
    rgb[:, :16] = 30
    overexposed = [seen for seen in shown(rgb, 60) if np.median(seen[:, 48]) > 250]
    line = np.array([seen[8:56, 32].mean() for seen in overexposed])
    wide = np.array([seen[8:56, 4].mean() for seen in overexposed])
    assert len(overexposed) > 20
    assert (line > 200).sum() > 5
    assert np.median(wide) < 120


def test_some_images_are_exposed_far_too_little_and_too_much():
    grey = np.full((32, 32, 3), 120, np.uint8)
    means = np.array([seen.mean() for seen in shown(grey, 300)])
    assert np.median(means) == pytest.approx(120, abs=30)
    assert (means < 60).mean() > 0.03
    assert (means > 225).mean() > 0.05
