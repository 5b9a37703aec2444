"""A calibration that the motion in the images contradicts."""

import pyarrow as pa
import pyarrow.parquet as pq

CAMERA = """image_width: 1600
image_height: 1200
camera_matrix: {{rows: 3, cols: 3, data: [{0}, 0, {1}, 0, {0}, {2}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [{3}, {4}, 0, 0, 0]}}
"""


def test_a_run_notes_a_lens_that_cannot_be_right_and_the_one_that_the_images_ask_for(
    run_demo, default_demo, true_boxes, tmp_path
):
    assert default_demo.about["camera_by_motion"] is None
    pq.write_table(pa.Table.from_pylist(true_boxes), tmp_path / "boxes.parquet")
    true = default_demo.about["camera"]
    (tmp_path / "camera.yaml").write_text(
        CAMERA.format(1.1 * true["fx"], true["cx"], true["cy"], *true["distortion"][:2])
    )
    result = run_demo(
        *("--detections", str(tmp_path / "boxes.parquet")),
        *("--calibration", str(tmp_path / "camera.yaml")),
    )
    found = result.about["camera_by_motion"]
    assert abs(found["fx"] / true["fx"] - 1) < 0.03
    (note,) = [note for note in result.about["notes"] if "cannot be right" in note]
    assert f"a focal length of about {found['fx']:.0f} px" in note
