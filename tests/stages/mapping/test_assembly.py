from dataclasses import replace

import numpy as np

from wayside.schemas.detections import VERDICTS
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping.assembly import assemble, same_support
from wayside.stages.mapping.tracker import track
from wayside.stages.mapping.verdicts import same_panel


def assembled(frames):
    return list(assemble(track(iter(frames), TrackSettings())))


def landmarks_of(tracked):
    return [place for item in tracked for place in item.landmarks]


def test_panels_of_one_post_share_a_number_and_others_do_not(panel, drive):
    signs = [panel(3.5, 2.0, 120.0), panel(3.5, 1.2, 120.0), panel(-3.5, 1.2, 120.0)]
    by_side = {}
    for place in landmarks_of(assembled(drive(signs, 20))):
        by_side.setdefault(place.right_m > 0, set()).add(place.assembly)
    assert len(by_side[True]) == 1
    assert len(by_side[False]) == 1
    assert by_side[True] != by_side[False]


def test_posts_one_behind_the_other_are_two_supports(panel, drive):
    signs = [panel(3.5, 1.2, 120.0), panel(3.5, 1.2, 140.0)]
    numbers = [place.assembly for place in landmarks_of(assembled(drive(signs, 22)))]
    assert sorted(numbers) == [0, 1]


def test_a_second_place_of_one_panel_is_a_duplicate_with_its_candidates(panel, drive):
    (frames,) = [list(track(iter(drive([panel(3.5, 1.2, 120.0)], 20)), TrackSettings()))]
    first = next(i for i, item in enumerate(frames) if item.landmarks)
    twin = replace(frames[first].landmarks[0], track_id=99)
    later = first + 2
    track_id = np.full_like(frames[later].track_id, 99)
    frames[later] = replace(frames[later], landmarks=(twin,), track_id=track_id)
    tracked = list(assemble(iter(frames)))
    assert [p.verdict for p in landmarks_of(tracked)] == ["sign", "duplicate"]
    assert {VERDICTS[v] for v in tracked[later].candidates.verdict} == {"duplicate"}


def test_a_plaque_is_no_duplicate_of_the_sign_above(panel, drive):
    signs = [panel(3.5, 2.0, 120.0), panel(3.5, 1.4, 120.0, wide=0.6, tall=0.3)]
    one, other = landmarks_of(assembled(drive(signs, 20)))
    assert not same_panel(one, other)
    assert same_support(one, other)
    assert {one.verdict, other.verdict} == {"sign"}
