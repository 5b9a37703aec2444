"""Landmarks of labelled drives as samples of the location and the confidence."""

from pathlib import Path

import pytest

from wayside.pipeline.fitting.samples import LabelledDrive, by_side, landmark_samples, run_drives
from wayside.pipeline.labels.read import FrameLabels
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON, labelled_faces
from wayside.schemas.errors import InputError
from wayside.schemas.labels import SIGN, Label, LabelledImage

from ..asked import asked

BOX = (100.0, 50.0, 130.0, 80.0)


def drive(*, is_log=True, fold=None):
    """Twenty labelled frames of one drive in two stretches; sign `a` in 0 to 8, sign `b` in 9 to 12."""
    labels = {
        frame: [
            Label(LabelledImage(frame=frame), SIGN, BOX, "blue", panel="a" if frame < 9 else "b")
        ]
        for frame in range(13)
    }
    faces = labelled_faces(FrameLabels(labels, frozenset(range(20)), {}))
    stretch = {frame: frame // 10 for frame in range(20)}
    return LabelledDrive(Path("road.mcap"), is_log, faces, stretch, fold)


def samples(*rows, **how):
    """Landmarks (label, best frame, box, right, up) that the location was asked about."""
    columns = dict(zip(("frame", "box"), list(zip(*rows, strict=True))[1:3], strict=True))
    values = [row[3:] for row in rows]
    found = asked([row[0] for row in rows], values, "location", "right_up_m", **columns)
    return by_side(landmark_samples([(drive(**how), {"location": found})], "location"))


AWAY = (300.0, 50.0, 330.0, 80.0)


def test_landmarks_are_named_by_the_side_they_stand_on():
    found = samples(
        (ON, 3, BOX, 4.0, 1.0),
        (ON, 11, BOX, -4.0, 1.0),
        (ON, 5, BOX, 1.0, 5.0),
        (OFF, 2, AWAY, 6.0, 0.0),
        (NEITHER, 2, AWAY, 6.0, 0.0),
    )
    assert found.kind.tolist() == ["right", "left", "overhead", ""]
    assert found.values.tolist() == [[4, 1], [-4, 1], [1, 5], [6, 0]]


def test_two_landmarks_on_one_panel_are_one_sign_and_two_on_nothing_labelled_are_two():
    found = samples((ON, 3, BOX, 4.0, 1.0), (ON, 5, BOX, 4.2, 1.0), (ON, 11, BOX, 4.0, 1.0))
    assert found.sign[0] == found.sign[1] != found.sign[2]
    assert found.signs("right") == 2
    assert samples((ON, 18, BOX, 4.0, 1.0), (ON, 19, BOX, 4.0, 1.0)).signs("right") == 2


def test_a_sign_belongs_to_the_stretch_that_shows_it_most_wherever_it_is_best_seen():
    found = samples((ON, 9, BOX, 4.0, 1.0), (OFF, 9, AWAY, 4.0, 1.0), (OFF, 14, AWAY, 4.0, 1.0))
    assert found.stretch.tolist() == [1, 0, 1]
    assert found.fold.tolist() == found.stretch.tolist()
    assert samples((OFF, 14, AWAY, 4.0, 1.0), fold=7).fold.tolist() == [7]


def test_a_classifier_that_was_not_asked_has_no_samples():
    assert len(landmark_samples([(drive(), {})], "landmark")) == 0


def test_folders_of_images_have_no_landmarks():
    with pytest.raises(InputError, match="wayside import"):
        run_drives([drive(is_log=False)], None, None)
