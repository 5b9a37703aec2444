"""Values of another kind than expected in files of users: refused in words, whichever value and file it is."""

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wayside.pipeline.exporting.export import export
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.models import detector_file
from wayside.pipeline.models.detector_file import load_detector
from wayside.pipeline.reading.calibrations import parse_camera
from wayside.pipeline.reading.parts import bag_parts
from wayside.pipeline.results.result import read_run, read_table
from wayside.pipeline.reviewing.review import NO_REVIEW, find_review
from wayside.schemas.errors import InputError
from wayside.schemas.settings import ModelSettings
from wayside.schemas.tables import SIGNS
from wayside.stages.classifiers import OnnxNetwork

from .results import sign_row, table_of

YOLO = Path(__file__).parents[1] / "stages" / "detection" / "detectors" / "yolov8.onnx"
GROWING = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join(9 * [f'*a{k - 1}'])}]\n" for k in range(1, 12)
)
"""3e11 texts in a kilobyte."""
CAMERA = """
image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [438., 0., 305., 0., 437., 243., 0., 0., 1.]}
distortion_coefficients: {rows: 1, cols: 5, data: [-0.3, 0.1, 0., 0., 0.]}
"""
YAML = ["\0", "[" * 50_000, "2001-13-45", "a: &a [*a]", "{[]: 1}"]


def result(folder, **columns):
    """A result of one row, with some of its columns replaced."""
    table = table_of(SIGNS, [sign_row("a-0001", covariance=[0.0] * 6)])
    for name, column in columns.items():
        table = table.set_column(table.column_names.index(name), name, column)
    folder.mkdir()
    pq.write_table(table, folder / SIGNS.file)
    (folder / "run.json").write_text("{}")
    return folder


BAG = "rosbag2_bagfile_information: {relative_file_paths: [*a11]}"
READERS = {
    "not a camera calibration": (
        "camera.yaml",
        CAMERA + "distortion_model: *a11",
        lambda folder: parse_camera((folder / "camera.yaml").read_text(), "camera.yaml"),
    ),
    "not labels": ("data.yaml", "names: [*a11]", read_labels),
    "of the ROS 2 bag directory cannot be read": ("metadata.yaml", BAG, bag_parts),
}
"""What each reader of YAML says, its file, and a text of its kind that grows without end."""


@pytest.mark.parametrize("text", [None, *YAML])
@pytest.mark.parametrize("wanted", READERS)
def test_yaml_that_cannot_be_read_is_refused(tmp_path, wanted, text):
    name, growing, read = READERS[wanted]
    (tmp_path / name).write_text(GROWING + growing if text is None else text)
    with pytest.raises(InputError, match=wanted):
        read(tmp_path)


@pytest.mark.parametrize("change", [{"sign_id": ["a"]}, {"x": [1]}, {"color": {}}, {"review": []}])
def test_odd_values_of_reviews_are_refused(tmp_path, change):
    path = tmp_path / "review.json"
    entry = {"sign_id": "a-0001", "review": "accepted"} | change
    path.write_text(json.dumps({"wayside_review": 1, "result": "", "reviews": [entry]}))
    with pytest.raises(InputError, match="review 1:"):
        find_review(result(tmp_path / "out"), [path])


@pytest.mark.parametrize(
    ("column", "values"),
    [
        ("x", pa.array(["far"])),
        ("sign_id", pa.array([None], pa.string())),
        ("views", pa.array([[1]])),
        ("covariance", pa.array([[1.0, 2.0]])),
        ("best_time_ns", pa.array([1.5])),
    ],
)
def test_a_column_of_another_kind_is_refused_by_its_file(tmp_path, column, values):
    out = result(tmp_path / "out", **{column: values})
    with pytest.raises(InputError, match=r"signs\.parquet cannot be read"):
        export(out, NO_REVIEW, tmp_path / "signs.csv", "csv")
    assert not (tmp_path / "signs.csv").exists()
    wide = result(tmp_path / "wide", views=pa.array([3], pa.int64()))
    assert read_table(wide, SIGNS)["views"].type == SIGNS.schema.field("views").type


@pytest.mark.parametrize(
    "entry", [{"log": 3}, {"log_path": []}, {"files": []}, {"learned_from_log": 1}, {"camera": "x"}]
)
def test_entries_of_another_kind_in_run_json_are_refused(tmp_path, entry):
    (tmp_path / "run.json").write_text(json.dumps(entry))
    with pytest.raises(InputError, match=f"{next(iter(entry))}"):
        read_run(tmp_path)


@pytest.mark.parametrize("names", ["5", "{0: 1}", "{'a': 'b'}", "[" * 5000, "(" * 200, "1/0", "\0"])
def test_odd_names_of_the_classes_of_a_detector_are_none(monkeypatch, names):
    class Other(OnnxNetwork):
        def __init__(self, file):
            super().__init__(file)
            self.metadata = {"names": names}

    monkeypatch.setattr(detector_file, "OnnxNetwork", Other)
    load_detector(ModelSettings(detector=str(YOLO), detector_format="yolov8"))
