"""Where signs stand, which landmarks are one panel or hang on one support, and what becomes of their candidates."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import LocateSettings, TrackSettings
from wayside.stages.mapping import assemble, classify_location, track

LIMITS = LocateSettings()


def model(*means, space="right_up_m", threshold=2.0):
    classes = [
        GaussianClass(f"c{i}", np.array(mean), np.eye(2), threshold, "test", 1)
        for i, mean in enumerate(means)
    ]
    return GaussianModel(space, tuple(classes), "test")


def located(frames, where=None, settings=LIMITS):
    return assemble(classify_location(track(iter(frames), TrackSettings()), where, settings))


def landmarks_of(tracked):
    return [place for item in tracked for place in item.landmarks]


def verdicts_of(tracked):
    return {round(p.station_m): p.verdict for p in landmarks_of(tracked)}


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        (model((3.1, 0.6), (-4.0, 0.6)), ["sign", "sign", "location"]),  # near any class
        (model((3.121, 0.603)), ["sign", "location", "location"]),  # as in the report
        (None, ["sign", "sign", "sign"]),  # anywhere
    ],
)
def test_landmarks_far_from_where_signs_stand_are_refused(panel, drive, where, expected):
    signs = [panel(3.5, 1.0, 100.0), panel(-4.0, 1.0, 130.0), panel(3.0, 5.0, 140.0)]
    found = verdicts_of(located(drive(signs, 22), where))
    assert found == dict(zip((100, 130, 140), expected, strict=True))


def test_the_candidates_of_a_refused_landmark_follow_in_every_frame(panel, drive):
    tracked = list(located(drive([panel(-4.0, 1.0, 130.0)], 20), model((3.1, 0.6))))
    (landmark,) = landmarks_of(tracked)
    assert {VERDICTS[v] for item in tracked for v in item.candidates.verdict} == {"location"}
    assert {track for item in tracked for track in item.track_id} == {landmark.track_id}


def test_a_panel_of_no_signs_size_is_refused(panel, drive):
    settings = replace(LIMITS, largest_side_m=0.5)
    found = located(drive([panel(3.5, 1.0, 100.0)], 20), settings=settings)
    assert verdicts_of(found) == {100: "panel_size"}


def test_a_model_of_another_space_is_refused():
    with pytest.raises(ValueError, match="right_up_m"):
        list(classify_location(iter([]), model((0, 0), space="rgb"), LIMITS))


def test_panels_of_one_post_share_a_number_and_others_do_not(panel, drive):
    signs = [
        panel(3.5, 2.0, 120.0),
        panel(3.5, 1.2, 120.0),
        panel(-3.5, 1.2, 120.0),
        panel(3.5, 1.2, 140.0),
    ]
    by_post = {}
    for place in landmarks_of(located(drive(signs, 22))):
        by_post.setdefault((place.right_m > 0, round(place.station_m)), set()).add(place.assembly)
    assert sorted(number for numbers in by_post.values() for number in numbers) == [0, 1, 2]


def test_a_plaque_is_no_duplicate_of_the_sign_above(panel, drive):
    signs = [panel(3.5, 2.0, 120.0), panel(3.5, 1.4, 120.0, wide=0.6, tall=0.3)]
    one, other = landmarks_of(located(drive(signs, 20)))
    assert one.assembly == other.assembly
    assert {one.verdict, other.verdict} == {"sign"}


def test_every_candidate_of_a_landmark_carries_its_track_and_residual(panel, drive):
    tracked = list(located(drive([panel(3.5, 1.2, 120.0)], 20)))
    (landmark,) = landmarks_of(tracked)
    by_frame = {item.frame.index: item for item in tracked}
    for view in landmark.views:
        item = by_frame[view.frame]
        assert item.track_id[view.row] == landmark.track_id
        assert item.residual_px[view.row] == pytest.approx(view.residual_px, abs=1e-5)
        assert VERDICTS[item.candidates.verdict[view.row]] == "sign"
