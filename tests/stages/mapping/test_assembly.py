"""Where signs stand, which landmarks are one panel or hang on one support, and the verdicts of their candidates."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import LocateSettings, TrackSettings
from wayside.stages.mapping import assemble, classify_location, track

from ..made_frames import Panel, drive, landmarks_of, verdicts_of

LIMITS = LocateSettings()


def model(*means, space="right_up_m", distance=2.0):
    """Accepts up to a distance from a mean, all other places being as likely as each other."""
    classes = [GaussianClass(f"c{i}", np.array(mean), np.eye(2), 1) for i, mean in enumerate(means)]
    least = -(distance**2) / 2 - np.log(2 * np.pi)
    return GaussianModel(space, tuple(classes), "test", threshold=least - np.log(len(means)))


def located(frames, where=None, settings=LIMITS):
    return list(assemble(classify_location(track(iter(frames), TrackSettings()), where, settings)))


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        (model((3.1, 0.6), (-4.0, 0.6)), ["sign", "sign", "location"]),  # near any class
        (model((3.121, 0.603)), ["sign", "location", "location"]),  # as in the report
        (None, ["sign", "sign", "sign"]),  # anywhere
    ],
)
def test_landmarks_far_from_where_signs_stand_are_refused(where, expected):
    signs = [Panel(3.5, 1.0, 100.0), Panel(-4.0, 1.0, 130.0), Panel(3.0, 5.0, 140.0)]
    found = landmarks_of(located(drive(signs, 22), where))
    verdicts = {round(one.station_m): one.verdict for one in found}
    assert verdicts == dict(zip((100, 130, 140), expected, strict=True))
    assert not any("place" in dict(one.evidence) for one in found)  # a density is no evidence


@pytest.mark.parametrize(("where", "verdict"), [(model((3.1, 0.6)), "location"), (None, "sign")])
def test_candidates_have_track_verdict_and_residual_of_their_landmark(where, verdict):
    tracked = located(drive([Panel(-4.0, 1.0, 130.0)], 20), where)
    (landmark,) = landmarks_of(tracked)
    assert set(verdicts_of(tracked)) == {landmark.verdict} == {verdict}
    assert {track for item in tracked for track in item.track_id} == {landmark.track_id}
    for view in landmark.views:
        residual = tracked[view.frame].residual_px[view.row]
        assert residual == pytest.approx(view.residual_px, abs=1e-5)


def test_a_panel_of_no_signs_size_is_refused():
    settings = replace(LIMITS, largest_side_m=0.5)
    (found,) = landmarks_of(located(drive([Panel(3.5, 1.0, 100.0)], 20), settings=settings))
    assert found.verdict == "panel_size"


def test_a_model_of_another_space_is_refused():
    with pytest.raises(ValueError, match="right_up_m"):
        list(classify_location(iter([]), model((0, 0), space="rgb"), LIMITS))


def test_panels_of_one_post_share_a_number_and_others_do_not():
    places = [(3.5, 2.0, 120.0), (3.5, 1.2, 120.0), (-3.5, 1.2, 120.0), (3.5, 1.2, 140.0)]
    signs = [Panel(*place) for place in places]
    by_post = {}
    for place in landmarks_of(located(drive(signs, 22))):
        by_post.setdefault((place.right_m > 0, round(place.station_m)), set()).add(place.assembly)
    assert sorted(number for numbers in by_post.values() for number in numbers) == [0, 1, 2]
