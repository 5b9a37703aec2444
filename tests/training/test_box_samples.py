"""Boxes and targets of the box network: how far a box is a face, where its face lies, what is known of the rest."""

import numpy as np
import pytest

from training.box_samples import (
    IGNORED,
    NAMED,
    NO_FACE,
    REGRESSED,
    UNSURE_WEIGHTS,
    WHOLE_FACE,
    _targets,
    boxes_of_crop,
    laid_around,
    negative_weights,
)
from training.detector_crops import CROP_PX, KNOWN, UNKNOWN, UNSURE, drawn_crop, shown_faces
from training.detector_crops import targets as crop_targets
from training.detector_images import BACK, FRONT, LabelledImage
from training.face_drawings import FaceLibrary
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.stages.detection import MAPS, STRIDE, Maps
from wayside.stages.geometry import iou_matrix

from .test_detector_crops import NOISE, library
from .test_detector_crops import image as image_of

SIGN = [100, 60, 140, 100]
RED, OCTAGON = COLORS.index("red"), SHAPES.index("octagon")


class Blind:
    """A detection network that sees no face."""

    def maps(self, rgb):
        return Maps.of(np.full((MAPS, CROP_PX // STRIDE, CROP_PX // STRIDE), -10, np.float32))


class Seeing(Blind):
    """One that sees the front of a face of 32 px in the middle of every crop."""

    def maps(self, rgb):
        maps = super().maps(rgb).all()
        maps[0, 32, 32] = 5
        maps[2:4, 32, 32] = 0
        maps[4:6, 32, 32] = np.log(2)
        return Maps.of(maps)


def targets(boxes, faces=((SIGN, FRONT),), ignored=(), weight=1.0):
    rgb = np.zeros((CROP_PX, CROP_PX, 3), np.uint8)
    named = [(box, side, "red", "octagon") for box, side in faces]
    crop = LabelledImage.of(("set", "one"), rgb, named, ignored)
    box = np.array(boxes, np.float32)
    return _targets(box, crop, shown_faces(crop), np.full((len(box), 2), weight, np.float32))


def moved(overlap):
    """A box moved to the right of the sign, by as much as gives this IoU."""
    across = 40 * (1 - overlap) / (1 + overlap)
    return [SIGN[0] + across, SIGN[1], SIGN[2] + across, SIGN[3]]


def test_a_box_on_a_face_is_wholly_one_and_has_its_names():
    found = targets([SIGN], weight=0.0)
    assert found.panel.tolist() == [[1, 0]]
    assert found.offset.tolist() == [[0, 0, 0, 0]]
    assert (found.color.tolist(), found.shape.tolist()) == ([RED], [OCTAGON])
    assert found.weight.tolist() == [[1, 1]]
    assert found.size.tolist() == [[40, 40]]
    assert targets([SIGN], [(SIGN, BACK)]).panel.tolist() == [[0, 1]]


def test_the_less_a_box_overlaps_a_face_the_less_it_is_one():
    overlaps = [0.9, WHOLE_FACE, 0.6, NAMED + 0.01, 0.4, NO_FACE, 0.1]
    found = targets([moved(overlap) for overlap in overlaps])
    assert found.panel[:, FRONT] == pytest.approx([1, 1, 0.7, 0.42, 0.3, 0, 0], abs=1e-4)
    assert np.isfinite(found.offset).all(axis=1).tolist() == [o >= REGRESSED for o in overlaps]
    assert found.color.tolist() == [RED if o >= NAMED else NONE for o in overlaps]
    assert (found.weight == 1).all()


def test_offsets_move_a_box_onto_its_face():
    boxes = np.array([[96, 50, 150, 101], [110, 62, 139, 110], [99, 60, 120, 100]], np.float32)
    found = targets(boxes)
    onto = boxes + found.offset * np.tile(found.size, 2)
    np.testing.assert_allclose(onto, [SIGN] * 3, atol=1e-4)


def test_the_offsets_of_a_face_that_the_crop_cuts_end_at_its_border():
    (offset,) = targets([[0, 60, 20, 100]], [([-10, 60, 20, 100], FRONT)]).offset
    assert offset.tolist() == [0, 0, 0, 0]


def test_a_box_belongs_to_the_face_that_it_overlaps_most():
    found = targets([[135, 60, 180, 100]], [(SIGN, FRONT), ([145, 60, 185, 100], BACK)])
    assert found.panel.argmax(axis=1).tolist() == [BACK]


def test_where_nothing_is_known_a_box_off_all_faces_does_not_count():
    place, small = [10, 10, 50, 50], [200, 200, 206, 206]
    beside = [10 + 40 * (1 - IGNORED + 0.05), 10, 50 + 40 * (1 - IGNORED + 0.05), 50]
    boxes = [place, [12, 12, 52, 52], [200, 10, 240, 50], SIGN, beside, small]
    found = targets(boxes, [(SIGN, FRONT), (small, FRONT)], ignored=[place, SIGN])
    assert found.weight[:, 0].tolist() == [0, 0, 1, 1, 1, 0]
    assert found.panel[:, 0].tolist() == [0, 0, 0, 1, 0, 0]
    assert (targets([SIGN], [], weight=0.5).weight == 0.5).all()


def test_a_negative_counts_by_what_is_known_and_by_what_the_detection_network_sees():
    doubt = np.array([[KNOWN, KNOWN], [UNSURE, UNSURE], [UNSURE, UNKNOWN], [UNKNOWN, KNOWN]])
    seen = np.array([[-5, 5], [-5, 5], [3, 3], [-5, -5]], np.float32)
    below, above = UNSURE_WEIGHTS
    wanted = [[1, 1], [below, above], [above, 0], [0, 1]]
    weights = negative_weights(doubt.astype(np.uint8), seen)
    np.testing.assert_allclose(weights, wanted)
    assert weights.dtype == np.float32


def test_boxes_around_a_face_are_nearly_the_same_or_far_off():
    faces = np.array([SIGN, [10, 10, 20, 90]], np.float32)
    laid = laid_around(faces, 200, np.random.default_rng(1))
    assert laid.shape == (400, 4)
    assert (laid[:, 2:] > laid[:, :2]).all()
    for k in range(2):
        overlap = iou_matrix(laid[200 * k : 200 * k + 200], faces[k : k + 1])[:, 0]
        assert (overlap > 0.9).mean() > 0.15
        assert (overlap < 0.6).mean() > 0.15
    assert laid_around(faces[:0], 4, np.random.default_rng(1)).shape == (0, 4)


def image(faces=((SIGN, FRONT, "yellow", "diamond"),), **labelled):
    return image_of(faces, size=(CROP_PX, CROP_PX), **labelled)


def samples(seed, shown=None, network=None, faces=None):
    network = Blind() if network is None else network
    faces = FaceLibrary((), ()) if faces is None else faces
    rng = np.random.default_rng(seed)
    shown = image() if shown is None else shown
    crop = drawn_crop(shown, faces, NOISE, rng)
    return boxes_of_crop(crop, crop_targets(crop).doubt, network, rng)


def test_the_same_seed_gives_the_same_samples_and_another_one_others(bits):
    one, same, other = (samples(seed, faces=library()) for seed in (3, 3, 4))
    assert bits(one) == bits(same)
    assert bits(one) != bits(other)


def test_samples_of_crops_have_faces_named_and_others():
    parts = [samples(seed) for seed in range(20)]
    panel, color, size = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("panel", "color", "size")
    )
    assert (panel[:, FRONT] > 0.9).sum() > 20
    assert (panel[:, FRONT] == 0).sum() > 20
    least = (NAMED - NO_FACE) / (WHOLE_FACE - NO_FACE)
    share = panel[color != NONE].max(axis=1)
    assert ((share >= least - 1e-6) | (share == 0)).all()  # one of a second face as well is none
    assert {NONE, COLORS.index("yellow")} <= set(color)
    assert (size >= [3, 5]).all()


def test_the_boxes_of_the_detection_network_are_among_the_samples():
    for seed in range(6):
        assert [32, 32] in samples(seed, image(()), Seeing()).size.tolist()
        assert [32, 32] not in samples(seed, image(())).size.tolist()


def test_negatives_of_an_image_of_unboxed_signs_count_less():
    shown = image((), complete=False)
    for network, weight in ((Blind(), UNSURE_WEIGHTS[0]), (Seeing(), UNSURE_WEIGHTS[1])):
        found = samples(11, shown, network)
        off = found.panel.max(axis=1) == 0
        middle = (found.size == 32).all(axis=1) if weight == UNSURE_WEIGHTS[1] else off
        np.testing.assert_allclose(found.weight[off & middle, FRONT], weight)
    assert (samples(11, image(())).weight[:, FRONT] == 1).all()


def test_boxes_are_laid_around_what_is_labelled_as_no_sign_and_are_known_negatives():
    def known_negatives(**labelled):
        shown = image((), complete=False, **labelled)
        seen = [samples(seed, shown) for seed in range(30)]
        return sum(((s.weight[:, FRONT] == 1) & (s.panel[:, FRONT] == 0)).sum() for s in seen)

    assert known_negatives(other=[SIGN]) > known_negatives() + 30


def test_where_all_is_unknown_no_box_counts():
    shown = image((), complete=False, ignored=[[-100, -100, 356, 356]])
    for seed in range(6):
        assert not samples(seed, shown, Seeing()).weight.any()


def test_a_box_around_two_faces_is_none_and_one_around_a_face_with_another_on_it_is_one():
    plaque = [100, 101, 140, 120]
    found = targets([[100, 60, 140, 120], SIGN], faces=((SIGN, FRONT), (plaque, FRONT)))
    assert found.panel[:, FRONT].tolist() == [0, 1]
    within = [110, 70, 130, 90]
    assert targets([SIGN], faces=((SIGN, FRONT), (within, FRONT))).panel[0, FRONT] == 1
