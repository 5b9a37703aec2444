"""The learning script on tiny drives: flat faces pasted on noise, written as real logs."""

import json

import cv2
import numpy as np
import pytest

from wayside.pipeline.importing import import_images
from wayside.pipeline.learn import main
from wayside.pipeline.model_files import shipped_models
from wayside.schemas.errors import OutputError
from wayside.schemas.model_json import model_from_json

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


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    for seed, name in enumerate(("learn_a", "learn_b", "measured")):
        write_drive(folder, name, seed)
    status = main(["--drives", str(folder), "-o", str(folder / "models")])
    assert status == 0
    return folder


@pytest.mark.slow
def test_the_script_writes_every_model_with_its_provenance(learned):
    files = sorted(path.name for path in (learned / "models").iterdir())
    assert files == ["location.json"]
    for name in files:
        provenance = model_from_json((learned / "models" / name).read_text()).provenance
        assert "learn_a (6 images" in provenance
        assert "measured" not in provenance


@pytest.mark.slow
def test_the_same_drives_and_seed_give_the_same_bytes(learned, tmp_path):
    assert main(["--drives", str(learned), "-o", str(tmp_path)]) == 0
    for path in (learned / "models").iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_the_training_of_the_networks_wants_real_images(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main(["--drives", str(tmp_path), "-o", str(tmp_path), "--network-steps", "1"])
    assert end.value.code == 2
    assert "wants --real" in capsys.readouterr().err


def test_networks_that_may_have_seen_a_source_are_not_begun_from_to_leave_it_out(tmp_path, capsys):
    folder = str(tmp_path)
    asked = ["--drives", folder, "--real", folder, "-o", folder, "--network-steps", "1"]
    with pytest.raises(SystemExit) as end:
        main([*asked, "--begin-from", folder, "--without", "ca_city_garmin"])
    assert end.value.code == 2
    assert "may have seen the source" in capsys.readouterr().err


def test_a_source_to_leave_out_that_is_none_is_named(tmp_path, capsys):
    asked = ["--drives", str(tmp_path), "--real", str(tmp_path), "-o", str(tmp_path)]
    assert main([*asked, "--network-steps", "1", "--without", "garmin"]) == 3
    assert "found garmin" in capsys.readouterr().err


def test_the_models_that_ship_are_not_written_over_while_they_are_in_use(tmp_path, capsys):
    shipped = str(shipped_models())
    assert main(["--drives", str(tmp_path), "-o", shipped]) == OutputError.exit_status
    assert f"{shipped}: wanted a folder of its own" in capsys.readouterr().err


def test_a_folder_without_learning_drives_is_refused(tmp_path, capsys):
    assert main(["--drives", str(tmp_path), "-o", str(tmp_path)]) == 3
    assert "learn_*.mcap" in capsys.readouterr().err
