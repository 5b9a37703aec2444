import json
from hashlib import sha256

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.labels.box_accounting import BoxAccounting, paired
from wayside.pipeline.labels.box_file import CORNERS, load_boxes
from wayside.schemas.detections import COLORS, SHAPES, Candidates, Regions
from wayside.schemas.errors import InputError
from wayside.schemas.frame import USED, Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.stages.detection import boxes_of, score_log_odds


def load(path, **options):
    given = {"models.detections": str(path)} | options
    return load_boxes(load_settings("default", None, [], given)[0])


def parquet(folder, **columns):
    path = folder / "boxes.parquet"
    pq.write_table(pa.table(columns), path)
    return path


BOX = (1, 2, 3, 4)


def corners(*boxes):
    return dict(zip(CORNERS, np.array(boxes, float).reshape(-1, 4).T, strict=True))


def coco(folder, content):
    path = folder / "boxes.json"
    path.write_text(json.dumps(content))
    return path


def test_boxes_are_found_by_the_frame_they_are_of(tmp_path):
    box = corners((10, 20, 30, 40), (1, 2, 3, 4), (5, 6, 7, 8))
    path = parquet(tmp_path, frame=[7, 3, 7], score=[0.3, 0.9, 0.8], **box)
    found = load(path)
    assert sorted(found.boxes) == [3, 7]
    assert found.boxes[7].box.tolist() == [[5, 6, 7, 8], [10, 20, 30, 40]]  # the best first
    np.testing.assert_allclose(found.boxes[7].score, score_log_odds(np.array([0.8, 0.3])))
    assert (found.rows, found.left_out, found.key) == (3, {}, "frame")
    assert found.sha256 == sha256(path.read_bytes()).hexdigest()
    certain = load(parquet(tmp_path, frame=[0], **corners(BOX)))
    np.testing.assert_allclose(certain.boxes[0].score, score_log_odds(np.ones(1)))


def test_times_are_exact(tmp_path):
    time = 1700000000000000001
    for key, times in (("log_time_ns", (time, None)), ("header_time_ns", (5, time))):
        found = load(parquet(tmp_path, **{key: [time]}, **corners(BOX)))
        assert len(boxes_of(found, Frame(2, *times, USED, "jpeg", b"", None))) == 1
        assert len(boxes_of(found, Frame(2, time + 1, time + 1, USED, "jpeg", b"", None))) == 0


def test_names_of_images_are_matched_in_their_natural_order_and_all_must_be_named(tmp_path):
    names = ["img10.jpg", "img2.jpg", "img10.jpg"]
    found = load(parquet(tmp_path, image_name=names, **corners(*[BOX] * 3)))
    assert {number: len(one) for number, one in found.boxes.items()} == {0: 1, 1: 2}
    assert found_in(found, frames_of(2)) == [1, 2]
    for count in (1, 3):
        with pytest.raises(InputError, match=f"has {count}. The log does not name its images"):
            found_in(found, frames_of(count))


def test_rows_that_cannot_be_used_are_counted_by_reason(tmp_path):
    good = (1, 2, 3, 4)
    rows = [good, (np.nan, 2, 3, 4), (1, 2, np.inf, 4), (3, 2, 1, 4), (1, 2, 1, 4), good, good]
    scores = [0.9, 0.9, 0.9, 0.9, 0.9, 0.1, np.nan]
    path = parquet(tmp_path, frame=[0] * 7, score=scores, **corners(*rows))
    found = load(path)
    assert len(found.boxes[0]) == 1
    assert found.left_out == {"not_finite": 3, "no_area": 2, "below_score": 1}
    assert load(path, **{"candidates.external_score": 0.05}).left_out["no_area"] == 2
    assert len(load(path, **{"candidates.external_score": 0.05}).boxes[0]) == 2


@given(
    box=arrays(np.float64, (5, 4), elements=st.floats(allow_nan=True, allow_infinity=True)),
    score=arrays(np.float64, 5, elements=st.floats(0, 1) | st.just(np.nan)),
)
def test_every_row_is_used_or_counted(tmp_path_factory, box, score):
    folder = tmp_path_factory.getbasetemp()
    found = load(parquet(folder, frame=[0, 0, 1, 1, 2], score=score, **corners(*box)))
    assert sum(map(len, found.boxes.values())) + sum(found.left_out.values()) == 5
    for one in found.boxes.values():
        assert (one.box[:, 2:] > one.box[:, :2]).all()


def test_classes_say_which_boxes_are_signs_and_rows_what_they_look_like(tmp_path):
    classes = tmp_path / "classes.toml"
    classes.write_text('[classes]\nstop = { color = "red", shape = "octagon" }\nother = {}\n')
    look = {"class": ["stop", "car", "other", "stop"], "color": [None, "red", "blue", "white"]}
    look |= {"shape": pa.array([None, None, None, None], pa.string())}
    path = parquet(tmp_path, frame=[0, 1, 2, 3], **corners(*[BOX] * 4), **look)
    found = load(path, **{"models.classes": str(classes)})
    assert sorted(found.boxes) == [0, 2, 3]
    assert found.left_out == {"other_class": 1}
    kinds = {n: (one.color[0], one.shape[0]) for n, one in found.boxes.items()}
    red, blue, white = (COLORS.index(name) for name in ("red", "blue", "white"))
    octagon = SHAPES.index("octagon")
    assert kinds == {0: (red, octagon), 2: (blue, -1), 3: (white, octagon)}


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"frame": [0]}, "must have the columns x_min"),
        (corners(BOX), "one of frame, log_time_ns"),
        ({"frame": [0], "log_time_ns": [0], **corners(BOX)}, "one of frame"),
        ({"frame": ["a"], **corners(BOX)}, "column frame of type string instead of int64"),
        ({"frame": [None], **corners(BOX)}, "no value in 1 rows of column frame"),
        ({"frame": [0], "score": [90.0], **corners(BOX)}, "scores from 90 to 90 instead of 0 to 1"),
        ({"frame": [0], "score": [-2.0], **corners(BOX)}, "scores from -2 to -2 instead of 0"),
        ({"frame": [0], "color": ["purple"], **corners(BOX)}, "'purple' in column color"),
        ({"frame": [0], "shape": [3], **corners(BOX)}, "'3' in column shape"),
    ],
)
def test_columns_that_are_missing_or_wrong_are_refused(tmp_path, columns, words):
    with pytest.raises(InputError, match=words):
        load(parquet(tmp_path, **columns))


def data_set(**of_second):
    images = [{"id": 70, "file_name": "b10.jpg"}, {"id": 5, "file_name": "b9.jpg"} | of_second]
    boxes = [{"image_id": 70, "category_id": 2, "bbox": BOX}]
    boxes.append({"image_id": 5, "category_id": 3, "bbox": BOX, "score": 0.7})
    kinds = [{"id": 2, "name": "stop"}, {"id": 3, "name": "car"}]
    return {"images": images, "annotations": boxes, "categories": kinds}


def test_images_of_a_coco_data_set_are_matched_by_name_in_order(tmp_path):
    found = load(coco(tmp_path, data_set()))
    assert (found.key, len(found.names), sorted(found.boxes)) == ("image_name", 2, [0, 1])
    np.testing.assert_allclose(found.boxes[0].score, score_log_odds(np.array([0.7])))


def test_images_of_coco_may_say_their_frame_and_boxes_have_width_and_height(tmp_path):
    content = data_set(frame=33)
    content["images"][0]["frame"] = 31
    found = load(coco(tmp_path, content))
    assert (found.key, found.names, sorted(found.boxes)) == ("frame", (), [31, 33])
    entry = {"image_id": 4, "category_id": 9, "bbox": [10, 20, 5, 6], "score": 0.5}
    found = load(coco(tmp_path, [entry]))
    assert (found.key, found.names) == ("image_id", ())
    assert found.boxes[4].box.tolist() == [[10, 20, 15, 26]]


@pytest.mark.parametrize(
    "content",
    [
        {},
        [1],
        "boxes",
        [{"image_id": 1, "bbox": [1, 2, 3]}],
        [{"image_id": 1, "bbox": {}}],
        [{"image_id": float("inf"), "bbox": BOX}],
        [{"image_id": 2**70, "bbox": BOX}],
        [{"image_id": 1, "bbox": BOX, "score": [0.5, 0.5]}],
        [{"image_id": 1, "bbox": BOX, "category_id": []}],
        [{"bbox": BOX}],
        {**data_set(), "images": []},
        {**data_set(), "images": [{"id": 70, "file_name": "a"}, {"id": 5, "file_name": "a"}]},
    ],
)
def test_what_is_no_coco_is_refused(tmp_path, content):
    with pytest.raises(InputError, match="is not COCO JSON"):
        load(coco(tmp_path, content))


def frames_of(count, names=()):
    named = [*names, *[""] * (count - len(names))]
    return [Frame(k, k, None, USED, "jpeg", b"", None, name=named[k]) for k in range(count)]


def found_in(found, frames):
    """How many boxes each frame has."""
    accounting = BoxAccounting(found)
    paired(found, frames[0], len(frames))
    for frame in frames:
        rows = Candidates.of(Regions.empty())
        none = np.zeros(0, np.int32), np.zeros(0, np.float32)
        accounting.take(TrackedFrame(frame, None, rows, *none, 0))
    return [len(boxes_of(found, frame)) for frame in frames]


def results(*images):
    box = {"bbox": [1, 2, 3, 4], "score": 0.9}
    return [box | (image if isinstance(image, dict) else {"image_id": image}) for image in images]


def test_results_are_found_by_the_names_of_their_files_where_the_log_knows_them(tmp_path):
    rows = [{"image_id": k, "file_name": f"shots/IMG_{k}.JPG"} for k in (1, 2, 2, 4)]
    names = [f"IMG_{k}.JPG" for k in (1, 2, 3, 4)]
    assert found_in(load(coco(tmp_path, results(*rows))), frames_of(4, names)) == [1, 2, 0, 1]
    texts = load(coco(tmp_path, results("0002", "0001", "0002")))
    assert found_in(texts, frames_of(2, ["0001.jpg", "0002.jpg"])) == [1, 2]
    assert found_in(texts, frames_of(2)) == [1, 2]  # in order, where the log knows no names


def test_numbers_that_begin_at_1_are_refused_or_noted_and_others_are_counted(tmp_path):
    box = corners(*[BOX] * 3)
    with pytest.raises(InputError, match=r"frame 3 in .* is not a frame"):
        found_in(load(parquet(tmp_path, frame=[1, 2, 3], **box)), frames_of(3))
    assert found_in(load(parquet(tmp_path, frame=[0, 2, 3], **box)), frames_of(3)) == [1, 0, 1]
    first = frames_of(3)[0]
    assert paired(load(coco(tmp_path, results(0, 2))), first, 3) == []
    (note,) = paired(load(coco(tmp_path, results(1, 2))), first, 3)
    assert "begins at 1" in note


@pytest.mark.parametrize(
    "images", [[1, 2, 3, 4], [4], [0, 1, 900], [-1, 0], [{"image_id": 4, "file_name": "a.jpg"}]]
)
def test_an_image_id_that_is_no_frame_is_refused(tmp_path, images):
    words = "is not a frame of the log: its 4 images are the frames 0 to 3"
    with pytest.raises(InputError, match=words):
        found_in(load(coco(tmp_path, results(*images))), frames_of(4))


def test_names_that_contradict_each_other_are_refused(tmp_path):
    mixed = results({"image_id": 1, "file_name": "a.jpg"}, 2)
    with pytest.raises(InputError, match="others by image_name"):
        load(coco(tmp_path, mixed))
    found = load(coco(tmp_path, results("a", "b")))
    with pytest.raises(InputError, match="two images of the log have the name a"):
        found_in(found, frames_of(2, ["x/a.jpg", "y/a.jpg"]))


@pytest.mark.parametrize(
    "change", [{"bbox": []}, {"bbox": None}, {"score": "x"}, {"image_id": 1.5}]
)
def test_a_result_that_cannot_be_read_is_left_out_and_named(tmp_path, change):
    found = load(coco(tmp_path, [*results(0), results(1)[0] | change, *results(1)]))
    assert (found.rows, found.left_out) == (3, {"not_read": 1})
    assert found.fault.startswith("result 1: ")
    assert found_in(found, frames_of(2)) == [1, 1]


def test_a_file_that_is_no_table_or_without_any_box_of_the_log_is_refused(tmp_path):
    for content in (b"", b"no boxes", b"PAR1" + b"\0" * 40 + b"PAR1"):
        (tmp_path / "boxes.parquet").write_bytes(content)
        with pytest.raises(InputError, match=r"models\.detections: .* is neither a Parquet file"):
            load(tmp_path / "boxes.parquet")
    with pytest.raises(InputError, match="Correct the path"):
        load(tmp_path / "none.parquet")
    strange = (
        (parquet(tmp_path, frame=[900], **corners(BOX)), r"no frame in .*\(900 \.\.\.\) belongs"),
        (coco(tmp_path, results("elsewhere")), r"\(elsewhere \.\.\.\)"),
    )
    for path, words in strange:
        with pytest.raises(InputError, match=words):
            BoxAccounting(load(path)).require_known()
    empty = BoxAccounting(load(parquet(tmp_path, frame=pa.array([], pa.int64()), **corners())))
    empty.require_known()
    assert empty.counts["given"] == 0
