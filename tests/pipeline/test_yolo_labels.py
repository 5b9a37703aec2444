"""Lines of YOLO: boxes, polygons, and what programs write behind them."""

import cv2
import numpy as np
import pytest

from wayside.pipeline.labels.read import read_labels
from wayside.schemas.errors import InputError

WIDTH, HEIGHT = 400, 300
BOXES = [(0.68, 0.52, 0.012, 0.021), (0.4, 0.51, 0.03, 0.025), (0.2, 0.3, 0.05, 0.08)]


def corners(x, y, w, h):
    left, top, right, low = x - w / 2, y - h / 2, x + w / 2, y + h / 2
    return [left, top, right, top, right, low, left, low]


def data_set(folder, lines, name="a", points=None):
    cv2.imwrite(str(folder / f"{name}.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    texts = (" ".join(map(str, line)) for line in lines)
    (folder / f"{name}.txt").write_text("\n".join(texts) + "\n")
    if points is not None:
        (folder / "data.yaml").write_text(f"names: [stop]\nkpt_shape: {points}\n")


ON_IT = [0.6, 0.5, 2, 0, 0, 0]
"""Two key points, the second not seen."""
BEHIND = {
    "nothing": (None, lambda n, box: [*box]),
    "confidence": (None, lambda n, box: [*box, 0.91]),
    "track": (None, lambda n, box: [*box, n + 3]),
    "confidence and track": (None, lambda n, box: [*box, 0.91, n + 3]),
    "key points": ([4, 2], lambda n, box: [*box, *corners(*box)]),
    "seen key points": ([2, 3], lambda n, box: [*box, *ON_IT]),
    "key points, confidence and track": ([2, 3], lambda n, box: [*box, *ON_IT, 0.9, n]),
    "polygon": (None, lambda n, box: corners(*box)),
    "triangle": (None, lambda n, box: corners(*box)[:6]),
    "polygon and confidence": (None, lambda n, box: [*corners(*box), 0.8]),
}


@pytest.mark.parametrize("what", BEHIND)
def test_boxes_are_the_same_whatever_stands_behind_them(tmp_path, what):
    points, line = BEHIND[what]
    data_set(tmp_path, [[0, *line(n, box)] for n, box in enumerate(BOXES)], points=points)
    read = read_labels(tmp_path)
    sides = np.array([WIDTH, HEIGHT] * 2)
    pixels = np.array([np.array(corners(*box))[[0, 1, 4, 5]] * sides for box in BOXES])
    np.testing.assert_allclose([one.box for one in read.labels], pixels, atol=1e-6)
    outlined = what.startswith(("polygon", "triangle"))
    assert [bool(one.polygon) for one in read.labels] == [outlined] * len(BOXES)
    assert not read.left_out


@pytest.mark.parametrize(
    "bad",
    [
        [0, "nan", 0.5, 0.1, 0.1],
        [0, 0.5, 0.5, 0.1],
        ["stop", 0.5, 0.5, 0.1, 0.1],
        [0.5, 0.5, 0.5, 0.1, 0.1],
        [0, 200, 150, 30, 30],
        [0, 0.5, 0.5, 0.1, 0.1, 7.5],
        [0, 0.5, 0.5, 1e308, 0.1],
        [0, *corners(*BOXES[0]), 0.8, 7],
    ],
)
def test_a_line_that_is_no_box_is_left_out_and_named(tmp_path, bad):
    data_set(tmp_path, [[0, *BOXES[0]], bad, [0, *BOXES[1]]])
    data_set(tmp_path, [[0, *BOXES[2]]], "b")
    read = read_labels(tmp_path)
    assert len(read.labels) == 3
    assert read.left_out == {"no_box": 1}
    assert "a.txt, line 2" in read.reasons
    assert [image.image_name for image in read.complete] == ["b.png"]  # as a's sign is not known


@pytest.mark.parametrize(
    "line", [[*BOXES[0], *corners(*BOXES[0])], [*BOXES[2], 0.9, 1]], ids=["key points", "triangle"]
)
def test_a_line_that_can_be_a_box_or_a_polygon_is_refused(tmp_path, line):
    data_set(tmp_path, [[0, *line]])
    with pytest.raises(
        InputError, match=r"line 1: .* numbers can be a polygon or a box .* kpt_shape"
    ):
        read_labels(tmp_path)


def test_an_image_of_absurd_size_is_left_out(tmp_path):
    data_set(tmp_path, [[0, *BOXES[0]]])
    data_set(tmp_path, [[0, *BOXES[1]]], "b")
    png = bytearray((tmp_path / "b.png").read_bytes())
    png[16:24] = b"\x7f\xff\xff\xff" * 2  # width and height
    (tmp_path / "b.png").write_bytes(png)
    read = read_labels(tmp_path)
    assert len(read.labels) == 1
    assert read.left_out == {"image_not_readable": 1}
    assert "b.png" in read.reasons
