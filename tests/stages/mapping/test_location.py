from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import LocateSettings, TrackSettings
from wayside.stages.mapping.assembly import assemble
from wayside.stages.mapping.location import classify_location
from wayside.stages.mapping.tracker import track


def model(*means, space="right_up_m", threshold=2.0):
    classes = [
        GaussianClass(f"c{i}", np.array(mean), np.eye(2), threshold, "test", 1)
        for i, mean in enumerate(means)
    ]
    return GaussianModel(space, tuple(classes), "test")


LIMITS = LocateSettings()


def located(frames, *means, settings=LIMITS):
    return list(classify_location(track(iter(frames), TrackSettings()), model(*means), settings))


def landmarks_of(tracked):
    return {round(p.station_m): p.verdict for item in tracked for p in item.landmarks}


def test_a_place_near_any_class_of_the_mixture_stays(panel, drive):
    frames = drive([panel(3.5, 1.0, 100.0), panel(-4.0, 1.0, 130.0)], 20)
    found = landmarks_of(located(frames, (3.1, 0.6), (-4.0, 0.6)))
    assert set(found.values()) == {"sign"}


def test_the_single_mean_refuses_the_left_side_and_overhead(panel, drive):
    signs = [panel(3.5, 1.0, 100.0), panel(-4.0, 1.0, 130.0), panel(3.0, 5.0, 140.0)]
    found = landmarks_of(located(drive(signs, 22), (3.121, 0.603)))
    assert found == {100: "sign", 130: "location", 140: "location"}


def test_without_a_model_signs_stand_anywhere(panel, drive):
    tracked = track(iter(drive([panel(11.0, 1.0, 130.0)], 20)), TrackSettings())
    assert landmarks_of(classify_location(tracked, None, LIMITS)) == {130: "sign"}


def test_a_refused_places_candidates_follow_in_every_frame(panel, drive):
    tracked = iter(located(drive([panel(-4.0, 1.0, 130.0)], 20), (3.1, 0.6)))
    verdicts = [VERDICTS[v] for item in assemble(tracked) for v in item.candidates.verdict]
    assert set(verdicts) == {"location"}


def test_a_panel_of_no_signs_size_is_refused(panel, drive):
    frames = drive([panel(3.5, 1.0, 100.0)], 20)
    settings = replace(LIMITS, largest_side_m=0.5)
    assert landmarks_of(located(frames, (3.1, 0.6), settings=settings)) == {100: "panel_size"}


def test_a_model_of_another_space_is_refused():
    with pytest.raises(ValueError, match="right_up_m"):
        list(classify_location(iter([]), model((0, 0), space="rgb"), LocateSettings()))
