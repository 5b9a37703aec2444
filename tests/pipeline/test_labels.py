"""Labels: our own file, those of others, and which frame each is of."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayside.pipeline.labels.read import LogImages, labels_by_frame, read_labels
from wayside.pipeline.labels.wayside_labels import read_label_file, write_labels
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.labels import LABEL_KINDS, LABELS, Label, LabelledImage, Labels
from wayside.schemas.settings import ReadSettings

from .results import make_log

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
    corners = {"x_min": [1, None], "y_min": [2, None], "x_max": [11, None], "y_max": [22, None]}
    rest = {"image_name": ["1.jpg", "2.jpg"], "kind": ["sign", "complete"], "remark": ["", ""]}
    pq.write_table(pa.table(corners | rest), file)
    first, second = LabelledImage(image_name="1.jpg"), LabelledImage(image_name="2.jpg")
    assert read_label_file(file) == Labels((Label(first, "sign", (1, 2, 11, 22)),), (second,))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": ["traffic"]}, "row 0: kind 'traffic'"),
        ({"color": ["purple"]}, "colour 'purple'"),
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


def test_another_table_or_json_is_not_read_and_not_replaced(tmp_path):
    file = tmp_path / "other.parquet"
    pq.write_table(pa.table({"a": [1]}), file)
    with pytest.raises(InputError, match=r"the column .* is missing"):
        read_label_file(file)
    with pytest.raises(OutputError, match="another file"):
        write_labels(Labels((Label(NAME, "sign", (0, 0, 1, 1)),)), file)
    file.write_text(json.dumps([]))
    with pytest.raises(InputError, match="as Parquet"):
        read_label_file(file)
    file = tmp_path / "other.json"
    endless = '{"images": [{"id": 1, "width": Infinity}], "annotations": []}'
    for content in ("", "{}", "[]", endless):
        file.write_text(content)
        with pytest.raises(InputError, match=r"See docs/labels\.md"):
            read_labels(file)


SIZE = 320, 200
THINGS = [("stop", (10, 20, 41, 53)), ("back", (100, 0, 110, 30)), ("board", (200, 50, 320, 200))]
MAP = '[classes]\nstop = { color = "red", shape = "octagon" }\nback = {}\n'


def write_coco(folder):
    content = {
        "images": [{"id": 7, "file_name": "a 1.png", "width": SIZE[0], "height": SIZE[1]}],
        "categories": [{"id": n, "name": name} for n, (name, _) in enumerate(THINGS)],
        "annotations": [
            {"image_id": 7, "category_id": n, "bbox": [x0, y0, x1 - x0, y1 - y0]}
            for n, (_, (x0, y0, x1, y1)) in enumerate(THINGS)
        ],
    }
    (folder / "coco.json").write_text(json.dumps(content))
    return folder / "coco.json"


def write_yolo(folder):
    for part in ("images/train", "labels/train"):
        (folder / part).mkdir(parents=True)
    cv2.imwrite(str(folder / "images/train/a 1.png"), np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    cv2.imwrite(str(folder / "images/train/b.png"), np.zeros((20, 20, 3), np.uint8))
    names = [name for name, _ in THINGS]
    (folder / "data.yaml").write_text(f"names: {names}\n")
    lines = [
        f"{n} {(x0 + x1) / 2 / SIZE[0]} {(y0 + y1) / 2 / SIZE[1]} {(x1 - x0) / SIZE[0]} {(y1 - y0) / SIZE[1]}\n"
        for n, (_, (x0, y0, x1, y1)) in enumerate(THINGS)
    ]
    (folder / "labels/train/a 1.txt").write_text("".join(lines))
    return folder


def write_voc(folder):
    objects = "".join(
        f"<object><name>{name}</name><difficult>0</difficult><bndbox><xmin>{x0 + 1}</xmin><ymin>{y0 + 1}</ymin>"
        f"<xmax>{x1}</xmax><ymax>{y1}</ymax></bndbox></object>"
        for name, (x0, y0, x1, y1) in THINGS
    )
    size = f"<size><width>{SIZE[0]}</width><height>{SIZE[1]}</height><depth>3</depth></size>"
    (folder / "a 1.xml").write_text(
        f"<annotation><filename>a 1.png</filename>{size}{objects}</annotation>"
    )
    return folder


@pytest.fixture(params=[write_coco, write_yolo, write_voc])
def write(request):
    return request.param


def test_formats_of_others_say_the_same(tmp_path, write):
    read = read_labels(write(tmp_path))
    image = LabelledImage(image_name="a 1.png", size=SIZE)
    said = [(label.kind, label.note) for label in read.labels]
    assert said == [("sign", "stop"), ("back", "back"), ("sign", "board")]
    np.testing.assert_allclose([label.box for label in read.labels], [box for _, box in THINGS])
    assert {label.image for label in read.labels} == {image}
    assert read.complete == (image,)
    assert read.left_out == ({"image_without_text": 1} if write is write_yolo else {})


def test_a_class_map_says_which_are_signs(tmp_path, write):
    classes = tmp_path / "classes.toml"
    classes.write_text(MAP)
    path = write(tmp_path)
    read = read_labels(path, classes)
    said = [(label.kind, label.color, label.shape) for label in read.labels]
    assert said == [("sign", "red", "octagon"), ("sign", None, None)]
    assert read.left_out["other_class"] == 1
    classes.write_text('[classes]\n"stop sing" = {}\n')
    with pytest.raises(InputError, match=r"none of 'stop sing' is a class of"):
        read_labels(path, classes)


def test_coco_may_state_frames_times_and_polygons_and_an_image_that_lacks_a_box_is_open(tmp_path):
    corners = [20.0, 10.0, 40.0, 10.0, 30.0, 30.0]
    content = {
        "images": [{"id": n, "frame": n, "log_time_ns": 10 * n} for n in (1, 2, 3)],
        "annotations": [
            {"image_id": 1, "category_id": 1},
            {"image_id": 2, "bbox": [20, 10, 0, 20]},
            {"image_id": 3, "bbox": [20, 10, 20, 20], "segmentation": [corners]},
            {"image_id": 9, "bbox": [20, 10, 20, 20]},
        ],
    }
    (tmp_path / "coco.json").write_text(json.dumps(content))
    read = read_labels(str(tmp_path / "coco.json"))
    image = LabelledImage(frame=3, log_time_ns=30)
    assert read.complete == (image,)
    (label,) = read.labels
    assert (label.image, label.polygon) == (image, ((20, 10), (40, 10), (30, 30)))
    assert read.left_out == {"no_box": 1, "no_area": 1, "no_such_image": 1}


@pytest.mark.parametrize(
    ("part", "change"),
    [
        *(
            ("annotations", {"bbox": bbox})
            for bbox in ([], None, [1, 2, 3], "1 2 3 4", [0, 0, 1e308, 9], [0, 0, 9, 10**30])
        ),
        *(("images", change) for change in ({"width": 10**30}, {"height": 0}, {"frame": 2**40})),
    ],
)
def test_a_box_or_image_of_coco_of_absurd_numbers_is_left_out_and_named(tmp_path, part, change):
    content = json.loads(write_coco(tmp_path).read_text())
    content["images"].append(content["images"][0] | {"id": 8, "file_name": "b.png"})
    content["annotations"].append({"image_id": 8, "bbox": [1, 2, 3, 4]})
    content[part][-1] |= change
    (tmp_path / "coco.json").write_text(json.dumps(content))
    read = read_labels(tmp_path / "coco.json")
    write_labels(read, tmp_path / "labels.parquet")
    assert [label.note for label in read.labels] == [name for name, _ in THINGS]
    boxes, images = {"no_box": 1}, {"image_not_readable": 1, "no_such_image": 1}
    assert read.left_out == (boxes if part == "annotations" else images)
    assert ("annotation 3" if part == "annotations" else "image 1") in read.reasons


@pytest.mark.parametrize(
    ("text", "left_out"),
    [
        ("<annotation><object>", "image_not_readable"),
        ("<annotation><size><width>1e3</width></size></annotation>", "image_not_readable"),
        ("<annotation><object><bndbox><xmin>left</xmin></bndbox></object></annotation>", "no_box"),
    ],
)
def test_one_file_of_voc_that_cannot_be_read_is_left_out_and_named(tmp_path, text, left_out):
    (write_voc(tmp_path) / "b.xml").write_text(text)
    read = read_labels(tmp_path)
    assert len(read.labels) == len(THINGS)
    assert read.left_out == {left_out: 1}
    assert "b.xml" in read.reasons
    assert [image.image_name for image in read.complete] == ["a 1.png"]


def test_the_truth_of_a_drive_is_read_for_every_frame():
    truth = Path(__file__).parents[2] / "recordings" / "demo.truth.json"
    content = json.loads(truth.read_text())
    read = read_labels(truth)
    assert len(read.complete) == len(content["frames"])
    views = [view for sign in content["signs"] for view in sign["frames"]]
    signs = [label for label in read.labels if label.kind != "not_sign"]
    assert len(signs) == len(views)
    assert sum(label.kind == "back" for label in signs) == sum(v["side"] == "back" for v in views)
    # the middle of the first pixel is at 0 in the truth and at 0.5 in labels
    np.testing.assert_allclose([s.box for s in signs], np.array([v["box"] for v in views]) + 0.5)
    outlined = [label for label in signs if label.polygon]
    assert outlined
    for label in outlined:
        x, y = np.array(label.polygon).T
        np.testing.assert_allclose(label.box, (x.min(), y.min(), x.max(), y.max()), atol=0.02)


REAL = Path(__file__).parents[3] / "shared" / "data" / "real"


@pytest.mark.skipif(not REAL.is_dir(), reason="the real drives are not on this machine")
def test_hand_made_boxes_of_a_real_drive_are_read():
    file = REAL / "ca_city_garmin.labels.json"
    content = json.loads(file.read_text())
    read = read_labels(file)
    front = [sign for sign in content["signs"] if sign["facing"] == "front"]
    assert sum(label.kind == "sign" for label in read.labels) == sum(len(s["boxes"]) for s in front)
    assert {label.panel for label in read.labels if label.wanted and label.kind == "sign"} == {
        sign["id"] for sign in front if sign["wanted"]
    }
    assert not read.complete


def test_labels_find_their_frames_by_number_time_or_name():
    times = {0: 100, 1: 200, 2: 300, 3: 400}
    names = {0: "train/a.jpg", 1: "b.jpg", 2: "c.jpg", 3: "b.jpg"}
    found = {
        0: [LabelledImage(image_name="train/a.jpg")],
        1: [LabelledImage(frame=1)],
        2: [LabelledImage("drive", log_time_ns=300), LabelledImage("drive", 2, 300, "c.jpg")],
    }
    others = {
        "other_log": [LabelledImage("elsewhere", frame=1)],
        "other_time": [LabelledImage(log_time_ns=150), LabelledImage(frame=0, log_time_ns=200)],
        "no_such_image": [LabelledImage(frame=4), LabelledImage(frame=9, image_name="train/a.jpg")],
        "name_of_several": [LabelledImage(image_name="b.jpg")],
    }
    every = [image for group in (*found.values(), *others.values()) for image in group]
    read = Labels(tuple(Label(image, "sign", (0, 0, 5, 5)) for image in every), (found[2][0],))
    by_frame = labels_by_frame(read, "drive", times, names)
    assert {k: [label.image for label in own] for k, own in by_frame.labels.items()} == found
    assert by_frame.complete == {2}
    assert by_frame.left_out == {reason: len(group) for reason, group in others.items()}


def test_labels_find_the_images_of_an_imported_log_by_their_files(tmp_path):
    images = np.arange(2 * 120 * 160 * 3).astype(np.uint8).reshape(2, 120, 160, 3)
    known = LogImages.of(make_log(tmp_path / "drive.mcap", images), ReadSettings(spacing_m=8.0))
    assert known.names == {0: "000.png", 1: "001.png"}
    read = Labels((Label(LabelledImage(image_name="001.png"), "sign", (0, 0, 5, 5)),), ())
    assert list(labels_by_frame(read, "drive", known.times_ns, known.names).labels) == [1]


def test_the_page_describes_every_column_and_kind():
    page = (Path(__file__).parents[2] / "docs" / "labels.md").read_text()
    for column in LABELS.columns:
        assert re.search(rf"\| `{column.name}` \| .* \| {re.escape(column.words)} \|", page)
    for kind, words in LABEL_KINDS.items():
        assert f"| `{kind}` | {words} |" in page
