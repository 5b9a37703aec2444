"""What is learned from: samples of tiny drives, flat faces pasted on noise, written as real logs."""

import json

import cv2
import numpy as np
import pytest

from wayside.pipeline.importing import import_images
from wayside.pipeline.learning.faces import main_color
from wayside.pipeline.learning.gaussians import balanced, knee, location_model, moments
from wayside.pipeline.learning.samples import LEARN_READ, read_drive, read_truth, sign_positions
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.errors import InputError
from wayside.schemas.settings import Settings
from wayside.stages.imaging import decode

WIDTH, HEIGHT, FOCAL = 320, 240, 600.0
CALIBRATION = f"""image_width: {WIDTH}
image_height: {HEIGHT}
camera_matrix: {{rows: 3, cols: 3, data: [{FOCAL}, 0, 159.5, 0, {FOCAL}, 119.5, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
"""
COLORS = {"red": (180, 30, 40), "green": (20, 120, 70), "yellow": (235, 190, 30)}
BEHIND = {"id": 9, "faces_travel": False, "lateral_m": -5.0, "eligible_frames": 0}


def write_drive(folder, name, seed):
    """Six images of three rectangles each, with masks and truth."""
    rng = np.random.default_rng(seed)
    images = folder / f"{name}_images"
    masks = folder / f"{name}.masks"
    images.mkdir()
    masks.mkdir()
    signs = [
        {
            "id": k + 1,
            "kind": "plate",
            "color": color,
            "shape": "rectangle",
            "point_up": False,
            "faces_travel": True,
            "eligible_frames": 6,
            "lateral_m": 5.0 + k,
            "up_m": 2.5,
            "frames": [],
        }
        for k, color in enumerate(COLORS)
    ]
    backs = []
    for frame in range(6):
        rgb = rng.normal(110, 6, (HEIGHT, WIDTH, 3))
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        for k, sign in enumerate(signs):
            x, y = 20 + 90 * k + int(rng.integers(0, 30)), int(rng.integers(95, 115))
            w, h = int(rng.integers(16, 26)), int(rng.integers(16, 26))
            rgb[y : y + h, x : x + w] = np.array(COLORS[sign["color"]]) + rng.normal(
                0, 6, (h, w, 3)
            )
            mask[y : y + h, x : x + w] = sign["id"]
            box = [x, y, x + w, y + h]
            sign["frames"].append(
                {"frame": frame, "box": box, "side": "front", "visible_fraction": 1.0}
            )
        # its back is bare metal
        rgb[150:174, 40:60] = 190 + rng.normal(0, 6, (24, 20, 1))
        backs.append(
            {"frame": frame, "box": [40, 150, 60, 174], "side": "back", "visible_fraction": None}
        )
        bgr = np.clip(rgb, 0, 255).astype(np.uint8)[..., ::-1]
        cv2.imwrite(str(images / f"{frame:04d}.png"), bgr)
        cv2.imwrite(str(masks / f"{frame:04d}.png"), mask)
    signs.append(signs[0] | BEHIND | {"frames": backs})
    pose = {"position": [0, 0, 2.0], "quaternion": [-0.5, 0.5, -0.5, 0.5]}
    thing = {
        "kind": "barn",
        "position": [30.0, 12.0, 3.0],
        "frames": [{"frame": 0, "box": [0, 0, 9, 9]}],
    }
    truth = {
        "name": name,
        "camera": {"width": WIDTH, "height": HEIGHT, "mount": {"height_m": 2.0}},
        "signs": signs,
        "distractors": [thing],
        "frames": [{"index": k, **pose} for k in range(6)],
    }
    (folder / f"{name}.truth.json").write_text(json.dumps(truth))
    calibration = folder / "camera.yaml"
    calibration.write_text(CALIBRATION)
    import_images([images], calibration, 8.0, folder / f"{name}.mcap")
    return truth


def images_of(log):
    return decode(read_frames(log, LEARN_READ, ReadReport()))


def test_the_samples_of_a_drive_are_its_clear_faces_and_the_colours_of_what_is_none(tmp_path):
    truth = write_drive(tmp_path, "learn_a", 0)
    images = images_of(tmp_path / "learn_a.mcap")
    drive = read_drive(images, truth, tmp_path / "learn_a.masks", Settings())
    assert (drive.name, drive.frames, drive.size) == ("learn_a", 6, (WIDTH, HEIGHT))
    assert len(drive.faces) == 6 * len(COLORS)
    for face in drive.faces:
        assert face.rgb == pytest.approx(COLORS[face.color], abs=4)
    assert drive.places.tolist() == [[5.0, 0.5], [6.0, 0.5], [7.0, 0.5]]
    for painted in COLORS.values():
        assert np.linalg.norm(drive.background - painted, axis=1).min() > 30
    assert np.abs(drive.background - 190).max(axis=1).min() < 10  # the back is no face


def test_invented_faces_are_no_samples_of_the_classes_of_the_report(tmp_path):
    truth = write_drive(tmp_path, "learn_a", 0)
    truth["signs"][1]["kind"] = "invented"
    images = images_of(tmp_path / "learn_a.mcap")
    drive = read_drive(images, truth, tmp_path / "learn_a.masks", Settings())
    assert {face.color for face in drive.faces} == {"red", "yellow"}
    assert np.linalg.norm(drive.background - COLORS["green"], axis=1).min() > 30


def test_a_drive_without_images_is_refused(tmp_path):
    truth = write_drive(tmp_path, "learn_a", 0)
    with pytest.raises(InputError, match="learn_a: wanted images, found none"):
        read_drive([], truth, tmp_path / "learn_a.masks", Settings())


def test_a_truth_that_is_none_is_refused(tmp_path):
    path = tmp_path / "x.truth.json"
    path.write_text('{"name": "x"}')
    with pytest.raises(InputError, match="truth of a rendered drive"):
        read_truth(path)


def test_places_are_right_of_the_path_and_above_the_camera():
    truth = {
        "camera": {"mount": {"height_m": 1.5}},
        "signs": [
            {"faces_travel": True, "eligible_frames": 2, "lateral_m": 4.0, "up_m": 2.0},
            {"faces_travel": False, "eligible_frames": 2, "lateral_m": 9.0, "up_m": 2.0},
        ],
    }
    assert sign_positions(truth).tolist() == [[4.0, 0.5]]


def test_legends_and_borders_do_not_count_for_the_main_colour():
    face = np.full((100, 3), (20, 110, 60), np.uint8)
    face[:35] = 240
    assert main_color(face) == pytest.approx([20, 110, 60])


def test_every_sign_has_the_same_weight_however_often_it_is_seen():
    weight = balanced(["a", "a", "a", "b"])
    assert weight.sum() == pytest.approx(1)
    assert weight[:3].sum() == pytest.approx(weight[3])


def test_no_axis_of_a_class_is_narrower_than_the_floor():
    values = np.tile([1.0, 2.0], (5, 1))
    mean, covariance = moments(values, np.full(5, 0.2), np.array([0.5, 0.1]))
    assert mean.tolist() == [1, 2]
    assert (np.sqrt(np.diag(covariance)) >= [0.5, 0.1]).all()


def test_the_knee_parts_two_separate_groups_between_them():
    own, others = np.array([0.1, 0.5, 1.0]), np.array([3.0, 4.0])
    assert knee(own, others) == pytest.approx(2.0)


def test_signs_stand_right_left_and_above_of_the_road():
    rng = np.random.default_rng(2)
    places = np.concatenate(
        [
            rng.normal((6, 0.5), 0.5, (50, 2)),
            rng.normal((-8, 0.5), 0.5, (20, 2)),
            [(0, 4.5), (1, 4.6), (3, 4.4), (-1, 4.5)],
        ]
    )
    model = location_model(places, "made by hand")
    named = {one.name: one for one in model.classes}
    assert list(named) == ["right", "left", "overhead"]
    assert named["right"].mean == pytest.approx([6, 0.5], abs=0.3)
