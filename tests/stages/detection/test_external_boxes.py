from functools import cache
from pathlib import Path

import numpy as np
import pytest

from wayside.pipeline.models.detector_file import load_detector
from wayside.pipeline.models.model_files import shipped_models
from wayside.schemas.detections import COLORS, SHAPES, SOURCES, verdict_code
from wayside.schemas.detectors import BoxFile, DetectorFile, ExternalBoxes
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image
from wayside.schemas.settings import CandidateSettings, ModelSettings
from wayside.stages.detection import BoxNetwork, OnnxDetector, detect_externally

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)


def image(index=0, status=USED, camera=CAMERA):
    rgb = np.random.default_rng(index).integers(90, 110, (240, 320, 3)).astype(np.uint8)
    rgb[60:100, 200:240] = (240, 200, 40)
    used = status == USED
    frame = Frame(index, 1000 + index, None, status, "jpeg", b"", camera)
    return Image(frame, rgb if used else None, rgb[..., 0] if used else None)


def boxes(*rows, color=-1, shape=-1):
    count = len(rows)
    return ExternalBoxes(
        np.array([row[:4] for row in rows], np.float32),
        np.array([row[4] for row in rows], np.float32),
        np.full(count, color, np.int8),
        np.full(count, shape, np.int8),
        count,
    )


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


@pytest.mark.parametrize(("status", "camera"), [(THINNED, CAMERA), (USED, None)])
def test_an_image_that_is_not_used_has_no_candidates(status, camera):
    source = file_of(_0=boxes((200, 60, 240, 100, 2.0)))
    (one,) = detections([image(0, status, camera)], source)
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
    (named,) = detections([image()], file_of(_0=boxes(rows)))
    (known,) = detections([image()], file_of(_0=boxes(rows, color=blue)))
    assert COLORS[named.candidates.color[0]] in ("yellow", "orange")
    assert known.candidates.color.tolist() == [blue]
    assert known.candidates.color_log_probability is not None
    assert np.exp(known.candidates.color_log_probability[0]).tolist() == [
        float(k == blue) for k in range(len(COLORS))
    ]
    assert known.candidates.shape.tolist() == named.candidates.shape.tolist()
    np.testing.assert_array_equal(
        known.candidates.shape_log_probability, named.candidates.shape_log_probability
    )
    assert np.isfinite(named.candidates.shape_log_probability).any()
    assert 0 <= named.candidates.shape[0] < len(SHAPES)


def test_a_detector_is_run_on_every_used_image():
    onnx = Path(__file__).parent / "detectors" / "yolov8.onnx"
    source = load_detector(ModelSettings(detector=str(onnx)))
    found = detections([image(0), image(1, THINNED), image(2)], source)
    assert [len(one.candidates) > 0 for one in found] == [False, False, False]
    red = image(5)
    assert red.rgb is not None
    red.rgb[40:120, 80:160] = (255, 0, 0)  # one cell of the letterboxed input
    (one,) = detections([red], source)
    np.testing.assert_allclose(one.candidates.regions.box, [[80, 40, 160, 120]], atol=0.01)
