"""Real images as examples: which boxes count, and what an image with unboxed signs may teach."""

import numpy as np
import pytest

from wayside.pipeline.learning.detector_images import BACK, FRONT, labelled_image
from wayside.pipeline.learning.face_drawings import FaceDrawing, FaceLibrary
from wayside.pipeline.learning.samples import NEITHER, OFF, ON, FaceLabel
from wayside.pipeline.learning.scenes import (
    COPIES,
    FEW,
    as_images,
    labelled_images,
    real_faces,
    real_sources,
    scene_drive,
    with_drawn_faces,
)
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.settings import Settings

SIGN, THING = [300, 215, 330, 245], [400, 215, 430, 245]


def image(name="a", *, side=FRONT, ignored=(), color="red"):
    rgb = np.random.default_rng(3).normal(110, 6, (480, 640, 3)).clip(0, 255).astype(np.uint8)
    rgb[215:245, 300:330] = (180, 30, 40)
    rgb[215:245, 400:430] = (30, 60, 180)
    face = (SIGN, side, color, "rectangle")
    return labelled_image(
        "two", name, rgb, [face], ignored, fronts_complete=not ignored, backs_complete=False
    )


def label_near(drive, box, frame=0):
    """Labels of the candidates of an image whose middle is in a box."""
    middle = (drive.candidates.regions.box[:, :2] + drive.candidates.regions.box[:, 2:]) / 2
    inside = ((middle > box[:2]) & (middle < box[2:])).all(axis=1)
    return set(drive.candidates.label[inside & (drive.candidates.frame == frame)].tolist())


def test_images_have_a_camera_of_their_size():
    (one,) = as_images([image()])
    assert one.rgb[230, 315].tolist() == [180, 30, 40]
    assert (one.frame.camera.width, one.frame.camera.height) == (640, 480)


def test_boxed_signs_are_faces_and_what_lies_in_an_unknown_place_is_neither():
    labelled = [image(), image("b", ignored=[[390, 200, 440, 260]])]
    drive = scene_drive(as_images(labelled), "two", labelled, Settings())
    assert ON in label_near(drive, SIGN)
    assert label_near(drive, THING) == {OFF}
    assert ON in label_near(drive, SIGN, 1)
    assert label_near(drive, THING, 1) == {NEITHER}
    assert drive.signs[0] == FaceLabel("two/a/0", "red", "rectangle")
    assert drive.wanted.tolist() == [True, True]


def test_a_panel_from_behind_is_no_face_but_a_back():
    labelled = [image(side=BACK)]
    drive = scene_drive(as_images(labelled), "two", labelled, Settings())
    assert ON not in drive.candidates.label
    np.testing.assert_array_equal(drive.backs.box, [SIGN])
    assert not drive.backs.complete[0]


def test_faces_of_known_classes_are_samples_of_colour_and_shape():
    (face,) = real_faces([image(), image("b", color=None), image("c", side=BACK)])
    assert (face.sign, face.color, face.shape) == ("a/0", "red", "rectangle")
    np.testing.assert_allclose(face.rgb, (180, 30, 40), atol=1)


def test_small_sources_are_read_several_times():
    assert len(labelled_images(lambda: iter([image()]))) == COPIES
    assert len(labelled_images(lambda: iter([image()] * FEW))) == FEW


def test_nothing_is_learned_from_sources_that_are_for_tests_only(tmp_path):
    names = " ".join(real_sources(tmp_path))
    for source in ("kitti", "autobahn", "mb", "crops"):
        assert source not in names


@pytest.mark.parametrize("ignored", [[], [[0, 0, 640, 480]]])
def test_a_face_in_an_unknown_place_is_still_a_face(ignored):
    labelled = [image(ignored=ignored)]
    drive = scene_drive(as_images(labelled), "two", labelled, Settings())
    assert ON in drive.candidates.label


def test_faces_are_drawn_beside_the_road_off_what_is_known_and_become_examples():
    yellow = np.full((64, 64, 4), 255, np.uint8)
    yellow[..., :3] = (250, 190, 10)
    face = FaceDrawing(yellow, COLORS.index("yellow"), SHAPES.index("rectangle"))
    labelled = [image(str(n), ignored=[[0, 0, 640, 100]]) for n in range(12)]
    shown = with_drawn_faces(labelled, FaceLibrary((face,), (face,)), seed=1)
    altered = [one for one, plain in zip(shown, labelled, strict=True) if one is not plain]
    assert 0 < len(altered) < len(labelled)
    for one in altered:
        np.testing.assert_array_equal(one.box[0], SIGN)
        np.testing.assert_array_equal(one.rgb[215:245, 300:330], labelled[0].rgb[215:245, 300:330])
        assert (one.rgb[:100] == labelled[0].rgb[:100]).all()
    drawn = np.concatenate([one.box[1:] for one in altered])
    assert len(drawn) == sum(len(one.color) - 1 for one in altered) > len(altered)
    # hardly any straight ahead, where the road is
    assert (np.abs(drawn[:, [0, 2]].mean(axis=1) - 320) > 10).mean() > 0.8
    again = with_drawn_faces(labelled, FaceLibrary((face,), (face,)), seed=1)
    assert all((a.rgb == b.rgb).all() for a, b in zip(shown, again, strict=True))
    drive = scene_drive(as_images(shown), "two", shown, Settings())
    assert len(drive.wanted) == sum((one.side == FRONT).sum() for one in shown)
