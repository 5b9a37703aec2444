from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import (
    COLORS,
    SOURCES,
    VERDICTS,
    Candidates,
    Detections,
    Regions,
    Segmentation,
    verdict_code,
)
from wayside.schemas.errors import InputError
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image
from wayside.schemas.models import NetworkModel, TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection.box_regression import SIDES
from wayside.stages.detection.detector import REACH, gate_names, judge, view_names
from wayside.stages.detection.region_features import region_features

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)


def by_height(names, accept, gate=None):
    """A judge that scores by the height of the box alone: 1 from 12 px, 3 from 20 px, else -1."""
    column = names.index("log_height")
    return TreeModel(
        names,
        0.0,
        np.array([[column, 0, column, 0, 0]], np.int32),
        np.array([[np.log(11.9 / 300), 0, np.log(19.9 / 300), 0, 0]], np.float32),
        np.array([[1, -1, 3, -1, -1]], np.int32),
        np.array([[2, -1, 4, -1, -1]], np.int32),
        np.array([[0, -1, 0, 1, 3]], np.float32),
        accept,
        "made by hand",
        gate,
    )


JUDGE = by_height(view_names(), 0.0)


def judged(boxes, status=USED):
    box = np.array(boxes, np.float32).reshape(-1, 4)
    n = len(box)
    regions = Regions(box, np.full(n, 50), np.full((n, 3), 90, np.float32), np.zeros(n, np.uint8))
    rgb = np.random.default_rng(0).integers(0, 255, (240, 320, 3)).astype(np.uint8)
    used = status == USED
    picture = Image(
        Frame(0, 0, None, status, "jpeg", b"", CAMERA),
        rgb if used else None,
        rgb[..., 0] if used else None,
    )
    segmented = Segmentation(picture, regions, n, np.zeros((0, 3)), np.zeros(0), (0, 240))
    return Detections(segmented, Candidates.of(regions))


def verdicts(item):
    return [VERDICTS[v] for v in item.candidates.verdict]


def run(item, model=JUDGE, **settings):
    return next(judge(iter([item]), trees=model, settings=CandidateSettings(**settings)))


def test_what_scores_below_the_bar_goes_no_further():
    found = run(judged([[10, 10, 30, 20], [100, 10, 120, 25]]))
    assert verdicts(found) == ["score", "open"]
    assert found.candidates.score.tolist() == [-1, 1]


def test_of_overlapping_boxes_the_best_stays():
    found = run(judged([[10, 10, 26, 25], [10, 10, 27, 32], [100, 10, 120, 25]]))
    assert verdicts(found) == ["overlap", "open", "open"]


def test_the_first_of_equals_stays():
    found = run(judged([[10, 10, 26, 25], [11, 10, 27, 25]]))
    assert verdicts(found) == ["open", "overlap"]


def test_at_most_the_best_few_are_kept():
    found = run(judged([[10, 10, 25, 25], [100, 10, 120, 35], [200, 10, 215, 25]]), keep=2)
    assert verdicts(found) == ["open", "open", "score"]


def test_rows_decided_before_keep_their_verdict_and_stay_unscored():
    item = judged([[10, 10, 30, 40], [100, 10, 120, 40]])
    verdict = item.candidates.verdict.copy()
    verdict[0] = verdict_code("color")
    found = run(replace(item, candidates=replace(item.candidates, verdict=verdict)))
    assert verdicts(found) == ["color", "open"]
    assert np.isnan(found.candidates.score[0])


def test_what_the_gate_refuses_is_never_judged():
    gated = replace(JUDGE, gate=by_height(gate_names(), 2.0))
    found = run(judged([[10, 10, 30, 25], [100, 10, 120, 40]]), gated)
    assert verdicts(found) == ["glance", "open"]
    assert np.isnan(found.candidates.score[0])
    assert found.candidates.score[1] == 3


def test_a_picture_whose_candidates_all_fail_the_gate_has_none_open():
    gated = replace(JUDGE, gate=by_height(gate_names(), 99.0))
    assert verdicts(run(judged([[10, 10, 30, 25]]), gated)) == ["glance"]


def test_what_is_likelier_a_back_than_a_face_is_marked_so():
    lower = replace(by_height(view_names(), 0.5), bias=0.5)
    boxes = [[10, 10, 30, 20], [100, 10, 120, 25], [200, 10, 230, 40]]
    found = next(
        judge(iter([judged(boxes)]), trees=JUDGE, settings=CandidateSettings(), back=lower)
    )
    # by the judge of backs they are at -.5, 1.5 and 3.5, by that of faces at -1, 1 and 3
    np.testing.assert_allclose(found.candidates.back_score, [np.nan, 1.5, 3.5])
    assert verdicts(found) == ["score", "open", "open"]
    higher = replace(by_height(view_names(), 0.5), bias=-0.5)
    found = next(
        judge(iter([judged(boxes)]), trees=JUDGE, settings=CandidateSettings(), back=higher)
    )
    assert found.candidates.back_rows().tolist() == []


@pytest.mark.parametrize("item", [judged([]), judged([[1, 1, 20, 20]], status=THINNED)])
def test_pictures_without_candidates_or_pixels_travel_untouched(item):
    assert run(item) is item


def test_sizes_and_places_are_angles_whatever_the_camera():
    small = judged([[60, 50, 80, 90]]).candidates.regions
    large = replace(small, box=small.box * 2, area_px=small.area_px * 4)
    doubled = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
    assert region_features(small, CAMERA) == pytest.approx(
        region_features(large, doubled), abs=0.002
    )


def test_the_same_candidates_get_the_same_scores():
    boxes = [[10, 10, 26, 25], [100, 10, 127, 32]]
    one, other = run(judged(boxes)), run(judged(boxes))
    assert one.candidates.score.tobytes() == other.candidates.score.tobytes()


def by_aspect(features=("log_aspect",), classes=("red", "blue")):
    """A network that calls what is wider than tall blue."""
    one = np.ones(1, np.float32)
    wide = np.array([[0, 1]], np.float32)
    return NetworkModel(
        features, classes, 0 * one, one, one[None], 0 * one, 20 * wide, -wide[0], "made by hand"
    )


def test_what_passes_the_bar_is_named_and_the_rest_is_not():
    item = judged([[10, 10, 60, 30], [100, 10, 110, 35], [200, 10, 220, 20]])
    settings = CandidateSettings()
    found = next(judge(iter([item]), trees=JUDGE, settings=settings, color=by_aspect()))
    odds = found.candidates.color_odds
    assert [COLORS[k] for k in odds[:2].argmax(axis=1)] == ["blue", "red"]
    assert np.isnan(odds[2]).all()
    assert np.isneginf(odds[0, COLORS.index("white")])
    assert found.candidates.shape_odds is None


@pytest.mark.parametrize("strange", [{"features": ("smell",)}, {"classes": ("red", "plaid")}])
def test_a_network_of_unknown_features_or_names_is_refused(strange):
    with pytest.raises(InputError, match=r"smell|plaid"):
        next(judge(iter([]), trees=JUDGE, settings=CandidateSettings(), color=by_aspect(**strange)))


def grown(by):
    """A network that lowers the bottom of every box by a share of its height."""
    names = view_names()
    n = len(names)
    return NetworkModel(
        names,
        SIDES,
        np.zeros(n, np.float32),
        np.ones(n, np.float32),
        np.zeros((n, 1), np.float32),
        np.zeros(1, np.float32),
        np.zeros((1, 4), np.float32),
        np.array([0, 0, 0, by], np.float32),
        "made by hand",
    )


def test_a_box_on_part_of_a_face_is_moved_where_it_scores_better():
    item = judged([[20, 20, 36, 36], [100, 20, 130, 50]])
    settings = CandidateSettings()
    moved = next(judge(iter([item]), trees=JUDGE, settings=settings, box=grown(0.5)))
    assert moved.candidates.regions.box.tolist() == [[20, 20, 36, 44], [100, 20, 130, 50]]
    assert [SOURCES[s] for s in moved.candidates.regions.source] == ["moved", "pass1"]
    assert moved.candidates.score.tolist() == [3, 3]
    assert moved.candidates.center[0].tolist() == [27.5, 31.5]
    assert item.candidates.regions.box[0].tolist() == [20, 20, 36, 36]


def test_a_box_that_would_score_less_elsewhere_stays():
    item = judged([[20, 20, 44, 44]])
    moved = next(judge(iter([item]), trees=JUDGE, settings=CandidateSettings(), box=grown(-0.5)))
    assert np.array_equal(moved.candidates.regions.box, item.candidates.regions.box)
    assert moved.candidates.score.tolist() == [3]


def test_boxes_far_below_the_bar_are_not_moved():
    item = judged([[20, 20, 36, 31]])
    hopeless = replace(JUDGE, bias=-REACH - 1)
    moved = next(judge(iter([item]), trees=hopeless, settings=CandidateSettings(), box=grown(1.0)))
    assert np.array_equal(moved.candidates.regions.box, item.candidates.regions.box)
