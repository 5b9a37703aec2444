"""Shape classes of drawn faces, through segmentation and through boxes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from wayside.schemas.detections import SHAPES, SOURCES, VERDICTS, Candidates, Detections, Regions
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Frame, Image
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import GateSettings, RegionOutlineSettings, SegmentSettings
from wayside.stages.report.fourier import sequence_features, shape_dimensions
from wayside.stages.report.outline import SAMPLES, _resample
from wayside.stages.report.shape import classify_shape
from wayside.stages.segmentation.two_pass import segment

SETTINGS = RegionOutlineSettings()


def shape_features(outline, space):
    """Features of one outline given by its corners."""
    sequence = np.full(SAMPLES, complex(np.nan, np.nan))
    _resample(np.asarray(outline, np.float64), sequence)
    return sequence_features(sequence[None], space)[0]


def polygon(corners, turn=0.0):
    angle = turn + np.arange(corners) * 2 * np.pi / corners
    return np.column_stack([np.cos(angle), np.sin(angle)])


OUTLINES = {
    "rectangle": polygon(4, np.pi / 4),
    "diamond": polygon(4),
    "octagon": polygon(8, np.pi / 8),
    "triangle": polygon(3, -np.pi / 2),
}
YELLOW = (220, 180, 30)


def model(space="fourier6_oriented", threshold=4.0):
    spread = np.eye(shape_dimensions(space)) * 0.04**2
    classes = tuple(
        GaussianClass(name, shape_features(outline, space), spread, threshold, "by hand", 1)
        for name, outline in OUTLINES.items()
    )
    return GaussianModel(space, classes, "test")


def drawn(names, radius=24):
    """Faces side by side before a plain background, and the boxes of their pixels."""
    rgb = np.full((100, 100 * len(names), 3), (90, 120, 150), np.uint8)
    boxes = []
    for i, name in enumerate(names):
        corners = OUTLINES[name] * radius + [100 * i + 50, 50]
        mask = np.zeros(rgb.shape[:2], np.uint8)
        cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 1)
        rgb[mask > 0] = YELLOW
        ys, xs = np.nonzero(mask)
        boxes.append([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1])
    frame = Frame(0, 0, None, "used", "jpeg", b"", None)
    return Image(frame, rgb, cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)), np.array(boxes, np.float32)


def judged(picture, boxes, source):
    """Candidates of a source with these boxes, on top of a real segmentation."""
    settings = SegmentSettings(clusters=2, difference_clusters=2, whole_picture=True)
    (one,) = segment(iter([picture]), settings, GateSettings())
    if source == "pass1":
        yellow = np.abs(one.regions.rgb - YELLOW).max(axis=1) < 20
        regions = one.regions.select(yellow & (one.regions.source == 0))
        regions = regions.select(np.argsort(regions.box[:, 0]))
    else:
        n = len(boxes)
        regions = Regions(
            boxes,
            np.full(n, 100, np.int32),
            np.tile(np.array(YELLOW, np.float32), (n, 1)),
            np.full(n, SOURCES.index(source), np.uint8),
        )
    candidates = Candidates.of(regions)
    distance = np.arange(len(regions), dtype=np.float32)
    return Detections(one, replace(candidates, color_distance=distance))


def classify(item, gate=True, **how):
    (result,) = classify_shape(iter([item]), model=model(**how), settings=SETTINGS, gate=gate)
    return result.candidates


@pytest.mark.parametrize("source", ["pass1", "level", "stack"])
@pytest.mark.parametrize("radius", [9, 24, 40])
def test_drawn_faces_get_their_shape(source, radius):
    names = list(OUTLINES)
    candidates = classify(judged(*drawn(names, radius), source))
    assert [SHAPES[s] for s in candidates.shape] == names


def test_the_reports_features_take_a_square_for_a_diamond_or_the_reverse():
    candidates = classify(judged(*drawn(["rectangle", "diamond"]), "pass1"), space="fourier6")
    np.testing.assert_allclose(candidates.shape_distance, 0, atol=0.6)
    assert len(set(candidates.shape.tolist())) == 1


def test_a_shape_beyond_every_threshold_stops_at_shape_only_where_gated():
    item = judged(*drawn(["octagon"]), "level")
    gated, open_ = (classify(item, gate, threshold=1e-4) for gate in (True, False))
    assert VERDICTS[gated.verdict[0]] == "shape"
    assert VERDICTS[open_.verdict[0]] == "open"
    assert gated.shape_distance[0] == open_.shape_distance[0] > 0


def test_candidates_that_stopped_before_are_left_alone():
    item = judged(*drawn(["octagon", "diamond"]), "level")
    stopped = np.array([VERDICTS.index("color"), 0], np.uint8)
    candidates = classify(replace(item, candidates=replace(item.candidates, verdict=stopped)))
    assert candidates.verdict.tolist() == stopped.tolist()
    assert candidates.shape[0] == -1
    assert np.isnan(candidates.shape_distance[0])


def test_the_gate_looks_at_all_candidates():
    picture, boxes = drawn(["diamond"])
    item = judged(picture, np.repeat(boxes, SETTINGS.most + 30, axis=0), "level")
    assert (classify(item).shape == SHAPES.index("diamond")).all()


def test_without_the_gate_only_the_nearest_in_colour_are_looked_at():
    picture, boxes = drawn(["diamond"])
    item = judged(picture, np.repeat(boxes, SETTINGS.most + 30, axis=0), "level")
    backwards = item.candidates.color_distance[::-1].copy()
    candidates = classify(
        replace(item, candidates=replace(item.candidates, color_distance=backwards)), gate=False
    )
    assert (candidates.shape[:30] == -1).all()
    assert (candidates.shape[30:] == SHAPES.index("diamond")).all()


def test_a_box_with_nothing_in_it_has_no_shape():
    picture, _ = drawn(["diamond"])
    candidates = classify(judged(picture, np.array([[0, 0, 3, 3]], np.float32), "stack"))
    assert candidates.shape[0] == -1
    assert VERDICTS[candidates.verdict[0]] == "shape"


def test_frames_without_pixels_or_regions_pass():
    picture, _ = drawn(["diamond"])
    empty = Image(replace(picture.frame, status="thinned"), None, None)
    assert len(classify(judged(empty, np.zeros((0, 4), np.float32), "level"))) == 0


def test_models_of_unknown_shapes_are_refused():
    one = GaussianClass("heart", np.zeros(6), np.eye(6), 1.0, "", 1)
    with pytest.raises(InputError, match="'heart'"):
        next(
            classify_shape(
                iter([]), model=GaussianModel("fourier6", (one,), ""), settings=SETTINGS, gate=True
            )
        )
