"""Labels: our own file, those of others, and which frame each is of."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayside.pipeline.label_file import read_label_file, write_labels
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.labels import LABEL_KINDS, LABELS, Label, LabelledImage, Labels

NAME = LabelledImage(image_name="a/b 1.jpg", size=(640, 480))
edges = st.floats(-1e4, 1e4).map(lambda value: round(value, 3))
maybe = st.none() | st.text(min_size=1, max_size=8)
images = st.builds(
    LabelledImage,
    log=maybe,
    frame=st.integers(0, 2**31 - 1),
    log_time_ns=st.none() | st.integers(0, 2**62),
    image_name=maybe,
    size=st.none() | st.tuples(st.integers(1, 9999), st.integers(1, 9999)),
)
sides = st.floats(0.1, 1e4)
boxes = st.builds(lambda x, y, w, h: (x, y, x + w, y + h), edges, edges, sides, sides)
labels = st.builds(
    Label,
    images,
    st.sampled_from([kind for kind in LABEL_KINDS if kind != "complete"]),
    boxes,
    st.none() | st.sampled_from(COLORS),
    st.none() | st.sampled_from(SHAPES),
    st.lists(st.tuples(edges, edges), max_size=4).map(tuple),
    maybe,
    st.none() | st.floats(0, 1),
    st.booleans(),
    st.text(max_size=8),
    st.text(max_size=8),
)


@settings(max_examples=30)
@given(st.lists(labels, max_size=4), st.lists(images, max_size=2))
def test_a_file_gives_back_what_was_written(tmp_path_factory, some, complete):
    file = tmp_path_factory.mktemp("labels") / "labels.parquet"
    written = Labels(tuple(some), tuple(complete))
    write_labels(written, file)
    assert read_label_file(file) == written
    assert pq.read_schema(file).names == LABELS.schema.names


def test_a_file_of_four_corners_is_enough(tmp_path):
    file = tmp_path / "mine.parquet"
    pq.write_table(
        pa.table(
            {
                "image_name": ["1.jpg", "2.jpg"],
                "kind": ["sign", "complete"],
                "x_min": [1, None],
                "y_min": [2, None],
                "x_max": [11, None],
                "y_max": [22, None],
                "remark": ["", ""],
            }
        ),
        file,
    )
    first, second = LabelledImage(image_name="1.jpg"), LabelledImage(image_name="2.jpg")
    assert read_label_file(file) == Labels((Label(first, "sign", (1, 2, 11, 22)),), (second,))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": ["traffic"]}, "row 0: kind 'traffic'"),
        ({"color": ["pink"]}, "colour 'pink'"),
        ({"x_max": [1]}, "no area"),
        ({"x_max": [None]}, "no 'x_max'"),
        ({"image_name": [None]}, "named by its frame"),
    ],
)
def test_what_is_no_label_is_refused_by_its_row(tmp_path, change, words):
    file = tmp_path / "mine.parquet"
    row = {"kind": ["sign"], "image_name": ["1.jpg"], "x_min": [1], "y_min": [2], "x_max": [9]}
    pq.write_table(pa.table(row | {"y_max": [9]} | change), file)
    with pytest.raises(InputError, match=words):
        read_label_file(file)


def test_another_table_is_not_read_and_not_replaced(tmp_path):
    file = tmp_path / "other.parquet"
    pq.write_table(pa.table({"a": [1]}), file)
    with pytest.raises(InputError, match="none named"):
        read_label_file(file)
    with pytest.raises(OutputError, match="another file"):
        write_labels(Labels((Label(NAME, "sign", (0, 0, 1, 1)),)), file)
    file.write_text(json.dumps([]))
    with pytest.raises(InputError, match="as Parquet"):
        read_label_file(file)
