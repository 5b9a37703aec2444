from functools import cache
from pathlib import Path

import numpy as np
import pytest

from wayside.pipeline.models.detector_file import load_detector
from wayside.pipeline.models.model_folder import shipped_models
from wayside.schemas.detections import COLORS, LEARNED_COLORS, SOURCES, verdict_code
from wayside.schemas.detectors import BoxFile, DetectorFile, ExternalBoxes
from wayside.schemas.frame import THINNED, Camera
from wayside.schemas.settings import CandidateSettings, ModelSettings
from wayside.stages.detection import BoxNetwork, OnnxDetector, detect_externally

from ..made_frames import made_image

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)


def image(index=0, **how):
    rgb = np.random.default_rng(index).integers(90, 110, (240, 320, 3)).astype(np.uint8)
    rgb[60:100, 200:240] = (240, 200, 40)
    return made_image(rgb, index, **{"camera": CAMERA, **how})


def boxes(*rows, color=-1, shape=-1):
    table, count = np.array(rows, np.float32), len(rows)
    names = np.full(count, color, np.int8), np.full(count, shape, np.int8)
    return ExternalBoxes(table[:, :4], table[:, 4], *names, count)


def file_of(key="frame", **by_number):
    found = {int(name[1:]): one for name, one in by_number.items()}
    return BoxFile("boxes.parquet", "", key, found, sum(map(len, found.values())))


@cache
def network():
    """The box network that ships."""
    return BoxNetwork(str(shipped_models() / "box.onnx"))


def detections(items, source):
    settings = CandidateSettings()
    if isinstance(source, DetectorFile):
        source = OnnxDetector(source)
    return list(detect_externally(iter(items), source=source, settings=settings, network=network()))


def test_the_boxes_are_the_candidates_with_their_scores():
    source = file_of(_3=boxes((200, 60, 240, 100, 2.0), (10, 10, 30, 40, -0.5)))
    (one,) = detections([image(3)], source)
    table = one.candidates
    assert table.regions.box.tolist() == [[200, 60, 240, 100], [10, 10, 30, 40]]
    assert table.score.tolist() == [2.0, -0.5]
    assert table.verdict.tolist() == [verdict_code("open")] * 2
    assert set(table.regions.source) == {SOURCES.index("external")}
    np.testing.assert_allclose(table.regions.rgb[0], [240, 200, 40])
    np.testing.assert_allclose(table.center, [[219.5, 79.5], [19.5, 24.5]])
    assert one.segmentation.region_count == 2


def test_images_are_found_by_number_or_time():
    source = file_of("log_time_ns", _1002=boxes((200, 60, 240, 100, 2.0)))
    counts = [len(one.candidates) for one in detections([image(k) for k in range(4)], source)]
    assert counts == [0, 0, 1, 0]


@pytest.mark.parametrize("how", [{"status": THINNED}, {"camera": None}])
def test_an_image_that_is_not_used_has_no_candidates(how):
    (one,) = detections([image(0, **how)], file_of(_0=boxes((200, 60, 240, 100, 2.0))))
    assert len(one.candidates) == 0


def test_of_boxes_on_one_face_the_best_is_open_and_those_outside_the_image_are_dropped():
    rows = (200, 60, 240, 100, 1.0), (201, 60, 241, 100, 3.0)
    (one,) = detections([image()], file_of(_0=boxes(*rows)))
    assert one.candidates.verdict.tolist() == [verdict_code("overlap"), verdict_code("open")]
    cut = (300, 60, 340, 100, 1.0), (330, 60, 360, 100, 3.0)
    (one,) = detections([image()], file_of(_0=boxes(*cut)))
    assert one.candidates.regions.box.tolist() == [[300, 60, 320, 100]]


def test_the_network_names_what_the_classes_leave_open():
    blue = COLORS.index("blue")
    rows = (200, 60, 240, 100, 2.0)
    named, known, black = (
        detections([image()], file_of(_0=boxes(rows, color=color)))[0].candidates
        for color in (-1, blue, COLORS.index("black"))
    )
    assert COLORS[named.color[0]] in ("yellow", "orange")
    assert known.color.tolist() == [blue]
    odds = np.exp(known.color_log_probability[0])
    np.testing.assert_array_equal(odds, np.eye(len(LEARNED_COLORS))[blue])
    assert COLORS[black.color[0]] == "black"
    assert np.isnan(
        black.color_log_probability
    ).all()  # the network does not know it: the views vote
    assert known.shape.tolist() == named.shape.tolist() != [-1]
    shapes = named.shape_log_probability
    np.testing.assert_array_equal(known.shape_log_probability, shapes)
    assert np.isfinite(shapes).any()


def test_a_detector_is_run_on_every_used_image():
    onnx = Path(__file__).parent / "detectors" / "yolov8.onnx"
    source = load_detector(ModelSettings(detector=str(onnx)))
    red = image(5)
    red.rgb[40:120, 80:160] = (255, 0, 0)  # one cell of the letterboxed input
    found = detections([image(0), image(1, status=THINNED), red], source)
    assert [len(one.candidates) for one in found] == [0, 0, 1]
    box = found[-1].candidates.regions.box
    np.testing.assert_allclose(box, [[80, 40, 160, 120]], atol=0.01)
