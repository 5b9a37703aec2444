"""Shape classes of drawn and segmented faces."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from wayside.schemas.detections import SHAPES, VERDICTS, Candidates, Detections
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Frame, Image
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import GateSettings, SegmentSettings
from wayside.stages.report.outline import TERMS
from wayside.stages.report.shape import classify_shape
from wayside.stages.segmentation.two_pass import segment

from .test_fourier import polygon, shape_features

OUTLINES = {
    "diamond": polygon(4, radius=1),
    "octagon": polygon(8, np.pi / 8, radius=1),
    "triangle": polygon(3, -np.pi / 2, radius=1),
}
YELLOW = (220, 180, 30)


def model(threshold=4.0):
    spread = np.eye(len(TERMS)) * 0.04**2
    classes = tuple(
        GaussianClass(name, shape_features(outline), spread, threshold, "by hand", 1)
        for name, outline in OUTLINES.items()
    )
    return GaussianModel("fourier6", classes, "test")


def drawn(names, radius=24):
    """Faces side by side before a plain background."""
    rgb = np.full((100, 100 * len(names), 3), (90, 120, 150), np.uint8)
    for i, name in enumerate(names):
        corners = OUTLINES[name] * radius + [100 * i + 50, 50]
        cv2.fillPoly(rgb, [np.rint(corners).astype(np.int32)], YELLOW)
    frame = Frame(0, 0, None, "used", "jpeg", b"", None)
    return Image(frame, rgb, cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))


def candidates_of(image):
    """The faces as candidates of pass one, from left to right."""
    settings = SegmentSettings(clusters=2, difference_clusters=2, whole_picture=True)
    (one,) = segment(iter([image]), settings, GateSettings())
    yellow = np.abs(one.regions.rgb - YELLOW).max(axis=1) < 20
    regions = one.regions.select(yellow & (one.regions.source == 0))
    return Detections(one, Candidates.of(regions.select(np.argsort(regions.box[:, 0]))))


def classify(item, **how):
    (result,) = classify_shape(iter([item]), model=model(**how))
    return result.candidates


@pytest.mark.parametrize("radius", [9, 24, 40])
def test_drawn_faces_get_their_shape(radius):
    names = list(OUTLINES)
    candidates = classify(candidates_of(drawn(names, radius)))
    assert [SHAPES[s] for s in candidates.shape] == names
    assert (candidates.verdict == 0).all()


def test_a_shape_beyond_every_threshold_stops_at_shape():
    candidates = classify(candidates_of(drawn(["octagon"])), threshold=1e-4)
    assert VERDICTS[candidates.verdict[0]] == "shape"
    assert candidates.shape_distance[0] > 0


def test_candidates_that_stopped_before_are_left_alone():
    item = candidates_of(drawn(["octagon", "diamond"]))
    stopped = np.array([VERDICTS.index("color"), 0], np.uint8)
    candidates = classify(replace(item, candidates=replace(item.candidates, verdict=stopped)))
    assert candidates.verdict.tolist() == stopped.tolist()
    assert candidates.shape[0] == -1
    assert np.isnan(candidates.shape_distance[0])


def test_a_box_that_no_region_fills_has_no_shape():
    item = candidates_of(drawn(["diamond"]))
    moved = item.candidates.regions.box + np.float32(1)
    regions = replace(item.candidates.regions, box=moved)
    candidates = classify(replace(item, candidates=Candidates.of(regions)))
    assert candidates.shape[0] == -1
    assert VERDICTS[candidates.verdict[0]] == "shape"


def test_frames_without_pixels_or_regions_pass():
    image = drawn(["diamond"])
    empty = Image(replace(image.frame, status="thinned"), None, None)
    assert len(classify(candidates_of(empty))) == 0


def test_models_of_unknown_shapes_are_refused():
    one = GaussianClass("heart", np.zeros(6), np.eye(6), 1.0, "", 1)
    with pytest.raises(InputError, match="'heart'"):
        next(classify_shape(iter([]), model=GaussianModel("fourier6", (one,), "")))
