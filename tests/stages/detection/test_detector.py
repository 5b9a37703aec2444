from dataclasses import dataclass, replace

import numpy as np
import pytest

from wayside.schemas.detections import LEARNED_COLORS, SHAPES, SOURCES, VERDICTS, Segmentation
from wayside.schemas.frame import THINNED, USED, Camera
from wayside.schemas.models import NetworkSum, ScoreModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection.box_network import BoxScores
from wayside.stages.detection.detector import (
    LARGEST_OFFSET,
    REGRESSED_FROM,
    detect,
    regressed_boxes,
)

from ..made_frames import made_image, made_regions

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
FRONT = ScoreModel(0.0, "made by hand")


def scores_of_one(names, name, rows):
    """Scores of the rows by which it is nine times as likely that name as any other, up to a constant."""
    scores = np.full((rows, len(names)), 7.0, np.float32)
    scores[:, names.index(name)] += np.log(9)
    return scores


@dataclass(frozen=True)
class ByHeight:
    """A network that sees boxes alone: a front of 1 from 12 px, of 3 from 20 px, else -1; wider than tall is blue.

    `behind`: log odds of a back above those of a front. `offset`: of the four sides. `shift`: of all log odds.
    """

    behind: float = -9.0
    offset: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    shift: float = 0.0

    def scores(self, rgb, box):
        wide, tall = (box[:, 2:] - box[:, :2]).T
        front = np.select([tall >= 20, tall >= 12], [3.0, 1.0], -1.0).astype(np.float32)
        front += np.float32(self.shift)
        blue, red = (scores_of_one(LEARNED_COLORS, name, len(box)) for name in ("blue", "red"))
        offset = np.tile(np.array(self.offset, np.float32), (len(box), 1))
        look = (
            np.where((wide > tall)[:, None], blue, red),
            scores_of_one(SHAPES, "octagon", len(box)),
        )
        return BoxScores(front, front + np.float32(self.behind), offset, *look)


def unclassified(boxes, status=USED):
    regions = made_regions(boxes, (90, 90, 90), 50)
    rgb = np.random.default_rng(0).integers(0, 255, (240, 320, 3)).astype(np.uint8)
    image = made_image(rgb, status=status, camera=CAMERA)
    return Segmentation(image, regions, len(regions), np.zeros((0, 3)), np.zeros(0), (0, 240))


def verdicts(item):
    return [VERDICTS[v] for v in item.candidates.verdict]


def run(item, network=None, *, front=FRONT, back=None, **settings):
    how = {"settings": CandidateSettings(**settings), "network": network or ByHeight()}
    return next(detect(iter([item]), front=front, back=back, **how))


@pytest.mark.parametrize(
    ("boxes", "keep", "expected"),
    [
        ([[10, 10, 30, 20], [100, 10, 120, 25]], 9, ["score", "open"]),  # below the threshold
        # of overlapping ones the best stays, and the first of equals
        ([[10, 10, 26, 25], [10, 10, 27, 32], [100, 10, 120, 25]], 9, ["overlap", "open", "open"]),
        ([[10, 10, 26, 25], [11, 10, 27, 25]], 9, ["open", "overlap"]),
        ([[10, 10, 25, 25], [100, 10, 120, 35], [200, 10, 215, 25]], 2, ["open", "open", "score"]),
    ],
)
def test_the_score_decides_and_of_overlapping_boxes_the_best_stays(boxes, keep, expected):
    assert verdicts(run(unclassified(boxes), keep=keep)) == expected


def test_scores_of_both_networks_are_joined_where_it_was_learned_how():
    boxes = [[10, 10, 30, 25], [100, 10, 120, 40]]
    joined = ScoreModel(1.0, "made by hand", NetworkSum(0.5, 2.0, -1.0))
    scored = replace(unclassified(boxes), network_score=np.array([2, -2.5], np.float32))
    found = run(scored, front=joined)
    assert found.candidates.score.tolist() == [3.5, -4.5]
    assert verdicts(found) == ["open", "score"]
    assert run(unclassified(boxes), front=joined).candidates.score.tolist() == [1, 3]


def test_a_back_score_stands_where_it_exceeds_the_score_of_a_face():
    boxes = [[10, 10, 30, 20], [100, 10, 120, 25], [200, 10, 230, 40]]
    back = ScoreModel(0.5, "made by hand")
    # scores of backs are -.5, 1.5 and 3.5, those of faces -1, 1 and 3
    found = run(unclassified(boxes), ByHeight(behind=0.5), back=back)
    np.testing.assert_allclose(found.candidates.back_score, [np.nan, 1.5, 3.5])
    assert verdicts(found) == ["score", "open", "open"]
    found = run(unclassified(boxes), ByHeight(behind=-0.5), back=back)
    assert found.candidates.back_rows().tolist() == []
    assert run(unclassified(boxes), ByHeight(behind=0.5)).candidates.back_score is None


@pytest.mark.parametrize("item", [unclassified([]), unclassified([[1, 1, 20, 20]], status=THINNED)])
def test_images_without_regions_or_pixels_travel_undecided(item):
    found = run(item)
    assert found.segmentation is item
    assert found.candidates.regions is item.regions
    assert (found.candidates.verdict == 0).all()


def test_what_passes_the_threshold_is_named_and_the_rest_is_not():
    found = run(unclassified([[10, 10, 60, 30], [100, 10, 110, 35], [200, 10, 220, 20]]))
    odds = found.candidates.color_log_probability
    others = len(LEARNED_COLORS) - 1
    for row, name in enumerate(("blue", "red")):
        expected = np.where(np.array(LEARNED_COLORS) == name, 9, 1) / (9 + others)
        np.testing.assert_allclose(np.exp(odds[row]), expected, rtol=1e-5)
    np.testing.assert_allclose(np.exp(found.candidates.shape_log_probability[:2]).sum(axis=1), 1)
    assert np.isnan(odds[2]).all()
    assert [LEARNED_COLORS[k] for k in found.candidates.color[:2]] == ["blue", "red"]
    assert [SHAPES[k] for k in found.candidates.shape[:2]] == ["octagon", "octagon"]
    assert found.candidates.color[2] == found.candidates.shape[2] == -1


GROWN = ByHeight(offset=(0, 0, 0, 0.5))
"""Lowers the bottom of every box by half its height."""


def test_a_box_on_part_of_a_face_is_moved_where_it_scores_better():
    item = unclassified([[20, 20, 36, 36], [100, 20, 130, 50]])
    moved = run(item, GROWN)
    assert moved.candidates.regions.box.tolist() == [[20, 20, 36, 44], [100, 20, 130, 50]]
    assert [SOURCES[s] for s in moved.candidates.regions.source] == ["moved", "pass1"]
    assert moved.candidates.score.tolist() == [3, 3]
    assert moved.candidates.center[0].tolist() == [27.5, 31.5]
    assert item.regions.box[0].tolist() == [20, 20, 36, 36]


def test_a_moved_box_has_the_names_of_where_it_is_now():
    wide = unclassified([[20, 20, 38, 36]])
    named = [run(wide, network).candidates.color[0] for network in (None, GROWN)]
    assert [LEARNED_COLORS[color] for color in named] == ["blue", "red"]


@pytest.mark.parametrize(
    ("box", "network", "bottom"),
    [
        ([20, 20, 36, 36], replace(GROWN, behind=2.0, shift=-4.0), 44),  # on part of a back
        ([20, 20, 44, 44], ByHeight(offset=(0, 0, 0, -0.5)), 44),  # would score less elsewhere
        ([20, 20, 36, 31], replace(GROWN, shift=REGRESSED_FROM + 1.5), 36.5),
        ([20, 20, 36, 31], replace(GROWN, shift=REGRESSED_FROM + 0.5), 31),  # of low score
    ],
)
def test_a_box_is_moved_where_it_may_score_better(box, network, bottom):
    found = run(unclassified([box]), network, back=ScoreModel(0.0, "made by hand"))
    assert found.candidates.regions.box.tolist() == [[*box[:3], bottom]]


BOX = np.array([[100, 80, 120, 100], [10, 20, 50, 40]], np.float32)


@pytest.mark.parametrize(
    ("by", "moved"),
    [
        ((-0.5, 0.1, 0.25, 1.0), [[90, 82, 125, 120], [0, 22, 60, 60]]),  # by fractions of its size
        ((-1.0, -1.2, 0.0, 0.0), [[80, 56, 120, 100], [0, 0, 50, 40]]),  # to the border
        ((-9.0, 0.0, 0.0, 0.0), [[100 - LARGEST_OFFSET * 20, 80, 120, 100], [0, 20, 50, 40]]),
        ((0.9, 0.0, -0.9, 0.0), BOX),  # no face is so small, so low, so narrow
        ((0.0, 0.45, 0.0, -0.45), BOX),
        ((0.45, -1.0, -0.45, 1.0), BOX),
    ],
)
def test_sides_move_by_fractions_of_the_size_as_far_as_a_face_can_be(by, moved):
    offset = np.tile(np.array(by, np.float32), (len(BOX), 1))
    assert regressed_boxes(BOX, offset, CAMERA) == pytest.approx(np.array(moved))
