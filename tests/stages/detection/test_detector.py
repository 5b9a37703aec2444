from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import (
    COLORS,
    SOURCES,
    VERDICTS,
    Regions,
    Segmentation,
)
from wayside.schemas.errors import InputError
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image
from wayside.schemas.models import NetworkModel, TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection.box_regression import SIDES
from wayside.stages.detection.detector import detect
from wayside.stages.detection.feature_vectors import (
    box_feature_names,
    region_features,
)

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)


def by_height(names, threshold):
    """A box classifier that scores by the height of the box alone: 1 from 12 px, 3 from 20 px, else -1."""
    column = names.index("log_height")
    return TreeModel(
        names,
        0.0,
        np.array([[column, 0, column, 0, 0]], np.int32),
        np.array([[np.log(11.9 / 300), 0, np.log(19.9 / 300), 0, 0]], np.float32),
        np.array([[1, -1, 3, -1, -1]], np.int32),
        np.array([[2, -1, 4, -1, -1]], np.int32),
        np.array([[0, -1, 0, 1, 3]], np.float32),
        threshold,
        "made by hand",
    )


CLASSIFIER = by_height(box_feature_names(), 0.0)


def unclassified(boxes, status=USED):
    box = np.array(boxes, np.float32).reshape(-1, 4)
    n = len(box)
    regions = Regions(box, np.full(n, 50), np.full((n, 3), 90, np.float32), np.zeros(n, np.uint8))
    rgb = np.random.default_rng(0).integers(0, 255, (240, 320, 3)).astype(np.uint8)
    used = status == USED
    image = Image(
        Frame(0, 0, None, status, "jpeg", b"", CAMERA),
        rgb if used else None,
        rgb[..., 0] if used else None,
    )
    return Segmentation(image, regions, n, np.zeros((0, 3)), np.zeros(0), (0, 240))


def verdicts(item):
    return [VERDICTS[v] for v in item.candidates.verdict]


def run(item, model=CLASSIFIER, **settings):
    return next(detect(iter([item]), classifier=model, settings=CandidateSettings(**settings)))


def test_a_score_below_the_threshold_is_a_verdict():
    found = run(unclassified([[10, 10, 30, 20], [100, 10, 120, 25]]))
    assert verdicts(found) == ["score", "open"]
    assert found.candidates.score.tolist() == [-1, 1]


def test_of_overlapping_boxes_the_best_stays():
    found = run(unclassified([[10, 10, 26, 25], [10, 10, 27, 32], [100, 10, 120, 25]]))
    assert verdicts(found) == ["overlap", "open", "open"]


def test_the_first_of_equals_stays():
    found = run(unclassified([[10, 10, 26, 25], [11, 10, 27, 25]]))
    assert verdicts(found) == ["open", "overlap"]


def test_at_most_the_best_few_are_kept():
    found = run(unclassified([[10, 10, 25, 25], [100, 10, 120, 35], [200, 10, 215, 25]]), keep=2)
    assert verdicts(found) == ["open", "open", "score"]


def test_a_segment_where_the_network_sees_no_face_gets_no_score():
    item = unclassified([[10, 10, 30, 25], [100, 10, 120, 40], [200, 10, 220, 40]])
    item.regions.source[2] = SOURCES.index("network")
    scored = replace(item, network_score=np.array([-4, -1, -4], np.float32))
    found = run(scored, segment_score=-2.0)
    assert verdicts(found) == ["glance", "open", "open"]
    assert np.isnan(found.candidates.score[0])
    assert found.candidates.score[1:].tolist() == [3, 3]


def test_an_image_in_which_the_network_sees_no_face_has_no_candidate_open():
    nothing = replace(unclassified([[10, 10, 30, 25]]), network_score=np.array([-6], np.float32))
    assert verdicts(run(nothing)) == ["glance"]


def test_a_back_score_stands_where_it_exceeds_the_score_of_a_face():
    lower = replace(by_height(box_feature_names(), 0.5), bias=0.5)
    boxes = [[10, 10, 30, 20], [100, 10, 120, 25], [200, 10, 230, 40]]
    found = next(
        detect(
            iter([unclassified(boxes)]),
            classifier=CLASSIFIER,
            settings=CandidateSettings(),
            back=lower,
        )
    )
    # the classifier of backs scores -.5, 1.5 and 3.5, that of faces -1, 1 and 3
    np.testing.assert_allclose(found.candidates.back_score, [np.nan, 1.5, 3.5])
    assert verdicts(found) == ["score", "open", "open"]
    higher = replace(by_height(box_feature_names(), 0.5), bias=-0.5)
    found = next(
        detect(
            iter([unclassified(boxes)]),
            classifier=CLASSIFIER,
            settings=CandidateSettings(),
            back=higher,
        )
    )
    assert found.candidates.back_rows().tolist() == []


@pytest.mark.parametrize("item", [unclassified([]), unclassified([[1, 1, 20, 20]], status=THINNED)])
def test_images_without_regions_or_pixels_travel_undecided(item):
    found = run(item)
    assert found.segmentation is item
    assert found.candidates.regions is item.regions
    assert (found.candidates.verdict == 0).all()


def test_sizes_and_places_are_angles_whatever_the_camera():
    small = unclassified([[60, 50, 80, 90]]).regions
    large = replace(small, box=small.box * 2, area_px=small.area_px * 4)
    doubled = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
    assert region_features(small, CAMERA) == pytest.approx(
        region_features(large, doubled), abs=0.002
    )


def test_the_same_candidates_get_the_same_scores():
    boxes = [[10, 10, 26, 25], [100, 10, 127, 32]]
    one, other = run(unclassified(boxes)), run(unclassified(boxes))
    assert one.candidates.score.tobytes() == other.candidates.score.tobytes()


def by_aspect(features=("log_aspect",), classes=("red", "blue")):
    """A network that calls what is wider than tall blue."""
    one = np.ones(1, np.float32)
    wide = np.array([[0, 1]], np.float32)
    return NetworkModel(
        features, classes, 0 * one, one, one[None], 0 * one, 20 * wide, -wide[0], "made by hand"
    )


def test_what_passes_the_threshold_is_named_and_the_rest_is_not():
    item = unclassified([[10, 10, 60, 30], [100, 10, 110, 35], [200, 10, 220, 20]])
    settings = CandidateSettings()
    found = next(detect(iter([item]), classifier=CLASSIFIER, settings=settings, color=by_aspect()))
    odds = found.candidates.color_log_probability
    assert [COLORS[k] for k in odds[:2].argmax(axis=1)] == ["blue", "red"]
    assert np.isnan(odds[2]).all()
    assert [COLORS[k] for k in found.candidates.color[:2]] == ["blue", "red"]
    assert found.candidates.color[2] == -1
    assert (found.candidates.shape == -1).all()
    assert np.isneginf(odds[0, COLORS.index("white")])
    assert found.candidates.shape_log_probability is None


@pytest.mark.parametrize("strange", [{"features": ("smell",)}, {"classes": ("red", "plaid")}])
def test_a_network_of_unknown_features_or_names_is_refused(strange):
    with pytest.raises(InputError, match=r"smell|plaid"):
        next(
            detect(
                iter([]),
                classifier=CLASSIFIER,
                settings=CandidateSettings(),
                color=by_aspect(**strange),
            )
        )


def grown(by):
    """A network that lowers the bottom of every box by a fraction of its height."""
    names = box_feature_names()
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
    item = unclassified([[20, 20, 36, 36], [100, 20, 130, 50]])
    settings = CandidateSettings()
    moved = next(
        detect(iter([item]), classifier=CLASSIFIER, settings=settings, regressor=grown(0.5))
    )
    assert moved.candidates.regions.box.tolist() == [[20, 20, 36, 44], [100, 20, 130, 50]]
    assert [SOURCES[s] for s in moved.candidates.regions.source] == ["moved", "pass1"]
    assert moved.candidates.score.tolist() == [3, 3]
    assert moved.candidates.center[0].tolist() == [27.5, 31.5]
    assert item.regions.box[0].tolist() == [20, 20, 36, 36]


def test_a_box_that_would_score_less_elsewhere_stays():
    item = unclassified([[20, 20, 44, 44]])
    moved = next(
        detect(
            iter([item]), classifier=CLASSIFIER, settings=CandidateSettings(), regressor=grown(-0.5)
        )
    )
    assert np.array_equal(moved.candidates.regions.box, item.regions.box)
    assert moved.candidates.score.tolist() == [3]


def test_boxes_far_below_the_threshold_are_not_moved():
    item = unclassified([[20, 20, 36, 31]])
    hopeless = replace(CLASSIFIER, bias=-CandidateSettings().regression_margin - 1)
    moved = next(
        detect(
            iter([item]), classifier=hopeless, settings=CandidateSettings(), regressor=grown(1.0)
        )
    )
    assert np.array_equal(moved.candidates.regions.box, item.regions.box)


def test_a_regressor_for_other_outputs_is_refused():
    other = replace(grown(0.5), classes=("a", "b", "c", "d"))
    with pytest.raises(InputError, match=r"box network.*found a, b, c, d"):
        next(detect(iter([]), classifier=CLASSIFIER, settings=CandidateSettings(), regressor=other))
    other = replace(grown(0.5), features=("smell",))
    with pytest.raises(InputError, match=r"box network.*smell"):
        next(detect(iter([]), classifier=CLASSIFIER, settings=CandidateSettings(), regressor=other))
