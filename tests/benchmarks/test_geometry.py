"""The geometry benchmark: what a stripped log keeps, and that exact poses and points have no error."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Pose


@pytest.fixture(scope="module")
def runs(load):
    return load("geometry_runs")


def path(count=8):
    """Poses along a bend, world axes x right, y down, z ahead."""
    turns = Rotation.from_rotvec(np.outer(np.arange(count), [0.0, 0.03, 0.001]))
    centres = np.column_stack(
        [0.1 * np.arange(count) ** 2, np.zeros(count), 8.0 * np.arange(count)]
    )
    return {i: Pose(turns[i].as_matrix(), centres[i]) for i in range(count)}


def test_a_stripped_log_keeps_the_kinds_asked_for(runs, tmp_path):
    full, part = tmp_path / "full.mcap", tmp_path / "part.mcap"
    with full.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for name in ("foxglove.CompressedImage", "foxglove.PoseInFrame", "foxglove.LocationFix"):
            schema = writer.register_schema(name, "jsonschema", b"{}")
            writer.add_message(writer.register_channel(f"/{name}", "json", schema), 1, b"{}", 1)
        writer.finish()
    for keep, left in ((runs.NOTHING_ELSE, 1), (runs.FIXES, 2)):
        runs.strip(full, part, keep)
        with part.open("rb") as stream:
            names = [schema.name for schema, _, _ in make_reader(stream).iter_messages()]
        assert len(names) == left
        assert "foxglove.PoseInFrame" not in names


def test_true_poses_have_no_error_whatever_their_world(runs):
    true = path()
    world = Pose(Rotation.from_rotvec([0.3, -1.0, 0.2]).as_matrix(), np.array([50.0, 3.0, -7.0]))
    moved = {i: world.compose(pose) for i, pose in true.items()}
    count, rotation, direction, way = runs.motion_cells(moved, true)
    assert count == "8"
    assert [float(v) for v in rotation.split("/")] == pytest.approx([0, 0], abs=1e-4)
    assert [float(v) for v in direction.split("/")] == pytest.approx([0, 0], abs=1e-3)
    assert way == "0.0 / 0.0"


def test_a_model_is_scaled_by_the_spacing_with_gaps(runs):
    frames = np.array([0, 1, 3, 4])
    model = {
        "frames": frames,
        "centres": np.outer(frames, [0.0, 0.0, 0.5]),
        "rotations": np.repeat(np.eye(3)[None], 4, axis=0),
    }
    poses, scale = runs.scaled_poses(model, path())
    assert scale == pytest.approx(26.4 * 0.3048 / 0.5)
    assert poses[4].centre[2] == pytest.approx(4 * 26.4 * 0.3048)


def test_points_on_a_face_have_no_error(runs):
    true = path()
    centre = true[3].to_world(np.array([3.0, -1.0, 18.0]))
    box = [[900.0, 400.0], [1200.0, 400.0], [1200.0, 650.0], [900.0, 650.0]]
    camera = {"width": 1600, "height": 1200, "fx": 1400.0, "fy": 1400.0, "cx": 799.5, "cy": 599.5}
    turns = {i: Rotation.from_matrix(p.rotation).as_quat().tolist() for i, p in true.items()}
    frames = [
        {"index": i, "position": p.centre.tolist(), "quaternion": turns[i]} for i, p in true.items()
    ]
    view = {"frame": 3, "side": "front", "range_m": 18.0, "polygons": [box]}
    sign = {"centre": centre.tolist(), "normal": (-true[3].rotation[:, 2]).tolist()}
    sign |= {"faces_travel": True, "frames": [view]}
    facts = {"camera": camera | {"distortion": []}, "frames": frames, "signs": [sign]}
    on_face = np.array([3.1, -0.9, 18.0])
    pixel = on_face[:2] / on_face[2] * 1400 + [799.5, 599.5]
    model = {"seen": np.array([[3, *pixel]]), "points": true[3].to_world(on_face)[None]}
    one = runs.Run("made up", runs.SPACING_ONLY, Path(), facts, 0.0)
    assert runs.peer_signs(one, model, true, 1.0) == pytest.approx(np.zeros((1, 3)), abs=1e-9)
