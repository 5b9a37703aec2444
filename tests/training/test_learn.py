"""The learning of where signs stand and of outlines, from white panels with a black border line."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from training import learn
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.models.model_folder import shipped_models
from wayside.pipeline.models.model_json import model_from_json
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.frame import USED, Camera, Frame, Image, Pose
from wayside.stages.panel import OUTLINE_FEATURES, PanelPlane, PosedImage, register_views

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"


def test_the_models_that_ship_are_not_written_over_while_they_are_in_use(tmp_path, capsys):
    shipped = str(shipped_models())
    assert learn.main(["--drives", str(tmp_path), "-o", shipped]) == OutputError.exit_status
    assert f"{shipped}: this is the folder of the models that ship" in capsys.readouterr().err


def test_a_folder_without_learning_drives_is_refused(tmp_path, capsys):
    assert learn.main(["--drives", str(tmp_path), "-o", str(tmp_path)]) == 3
    assert "learn_*.mcap" in capsys.readouterr().err


def test_signs_stand_right_left_and_above_of_the_road():
    random = np.random.default_rng(2)
    right, left = random.normal((6, 0.5), 0.5, (50, 2)), random.normal((-8, 0.5), 0.5, (20, 2))
    above = [(0, 4.5), (1, 4.6), (3, 4.4), (-1, 4.5)]
    model = learn.location_model(np.concatenate([right, left, above]), "made by hand")
    assert [one.name for one in model.classes] == ["right", "left", "overhead"]
    assert model.classes[0].mean == pytest.approx([6, 0.5], abs=0.3)


def test_both_models_say_what_they_were_learned_from_and_are_the_same_again(tmp_path):
    for name in ("a", "b"):  # one alone has too few faces
        for ending in (".mcap", ".truth.json"):
            (tmp_path / f"learn_{name}{ending}").symlink_to(DEMO.with_suffix(ending))
    texts = []
    for name in ("one", "same"):
        assert learn.main(["--drives", str(tmp_path), "-o", str(tmp_path / name)]) == 0
        texts.append(
            [(tmp_path / name / f"{one}.json").read_text() for one in ("location", "outline")]
        )
    assert texts[0] == texts[1]
    location, outline = map(model_from_json, texts[0])
    assert "rendered drives demo (" in location.provenance
    assert "seed 1" in outline.provenance
    assert int(outline.provenance.split(" faces")[0].split()[-1]) >= learn.FEWEST


CAMERA = Camera(640, 480, 560.0, 560.0, 319.5, 239.5)
WIDE, TALL, FRAMES, FINER = 0.75, 0.9, 4, 4
LOOKING_EAST = [-0.5, 0.5, -0.5, 0.5]


@pytest.fixture(scope="module")
def model():
    return load_models(load_settings()[0]).outline_weights


def sign(number, right):
    """A panel 30 m ahead of the first camera, which looks east; north is on its left."""
    views = [{"frame": k, "side": "front", "visible_fraction": 1.0} for k in range(FRAMES)]
    place = {"centre": [30.0, -right, 2.5], "normal": [-1.0, 0.0, 0.0], "frames": views}
    look = {"width_m": WIDE, "height_m": TALL, "shape": "rectangle", "point_up": False}
    return {"id": number} | place | look


def truth(count=3):
    frames = [
        {"index": k, "position": [4.0 * k, 0.0, 2.0], "quaternion": LOOKING_EAST}
        for k in range(FRAMES)
    ]
    signs = [sign(k + 1, right) for k, right in enumerate(np.linspace(-4.0, 4.0, count))]
    return {"name": "learn_a", "frames": frames, "signs": signs}


def images(known):
    """The panels as truth says, drawn FINER times as fine and shrunk."""
    for frame in known["frames"]:
        rng = np.random.default_rng(frame["index"])
        coarse = rng.integers(40, 200, (24, 32, 3)).astype(np.uint8)
        size = (CAMERA.width * FINER, CAMERA.height * FINER)
        rgb = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
        for one in known["signs"]:
            away = np.array(one["centre"]) - frame["position"]
            for inset, grey in ((0.0, 235), (0.03, 20), (0.06, 235)):
                half = np.array([WIDE, TALL]) / 2 - inset
                middle = np.array([-away[1], -away[2]])
                ends = np.array([middle - half, middle + half]) / away[0] * CAMERA.fx
                at = (ends + (CAMERA.cx, CAMERA.cy) + 0.5) * FINER - 0.5
                (x0, y0), (x1, y1) = np.round(at * 16).astype(int).tolist()
                cv2.rectangle(rgb, (x0, y0), (x1, y1), (grey,) * 3, -1, cv2.LINE_AA, 4)
        pixels = cv2.resize(rgb, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA)
        index = frame["index"]
        message = Frame(index, index, None, USED, "jpeg", b"", CAMERA, CAMERA.width, CAMERA.height)
        yield Image(message, pixels, None), pixels


def test_the_right_candidate_of_a_face_is_its_outer_edge(model):
    known = truth()
    choices = learn.gather_choices(images(known), known, model, 1)
    assert len(choices) >= 2 * len(known["signs"])
    names = list(OUTLINE_FEATURES)
    for choice in choices:
        assert choice.drive == "learn_a"
        assert choice.features.shape[1] == len(OUTLINE_FEATURES)
        width, height = (choice.features[:, names.index(n)] for n in ("log_width", "log_height"))
        # the detected box is the inner field, 6 % smaller, and a scatter of 5 % on either axis
        assert np.log(1.06) == pytest.approx((width + height)[choice.right[0]] / 2, abs=0.15)
        assert len(choice.features) > 1


def test_signs_without_a_position_or_a_template_teach_nothing(model):
    known = truth(2)
    shown = list(images(known))
    del known["signs"][0]["centre"]
    known["signs"][1]["shape"] = "shield"
    assert learn.gather_choices(shown, known, model, 1) == []


def test_the_true_box_is_that_of_the_projected_panel(model):
    pose = Pose(np.eye(3), np.zeros(3))
    image = PosedImage(0, pose, CAMERA, np.zeros((480, 640, 3), np.uint8))
    size = np.array([WIDE, TALL])
    ahead, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
    panel = PanelPlane.across(np.array([1.0, -0.5, 20.0]), ahead, up)
    registered = register_views(panel, size, [(20.0, image)], np.array([0]), model)
    np.testing.assert_allclose(learn.true_box(registered, panel, size), registered.box, atol=1e-9)
    # an angle of 60 degrees halves the width that it covers, nearly
    normal = np.array([np.sin(np.pi / 3), 0.0, np.cos(np.pi / 3)])
    rotated = PanelPlane.across(panel.point, normal, up)
    left, top, right, bottom = learn.true_box(registered, rotated, size) * registered.step
    assert right - left == pytest.approx(WIDE / 2, rel=0.1)
    assert bottom - top == pytest.approx(TALL, rel=1e-6)


def choices_by(weights, count, drives=("a", "b"), seed=0):
    """Faces of nine random candidates, of which one is right as a conditional logit of these weights draws it."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(count):
        features = rng.normal(size=(9, len(OUTLINE_FEATURES)))
        value = features @ weights + rng.gumbel(size=9)
        made.append(learn.OutlineChoice(features, [int(value.argmax())], drives[k % len(drives)]))
    return made


def test_the_weights_of_a_conditional_logit_come_back():
    weights = np.linspace(-2, 2, len(OUTLINE_FEATURES))
    model = learn.learn_outlines(choices_by(weights, 750), "made up")
    assert model.features == OUTLINE_FEATURES
    assert np.corrcoef(model.weights, weights)[0, 1] > 0.99
    assert "held out by drive right for" in model.provenance


def test_too_few_faces_are_refused_with_what_to_do():
    with pytest.raises(InputError, match="Add drives"):
        learn.learn_outlines(
            choices_by(np.zeros(len(OUTLINE_FEATURES)), learn.FEWEST - 1), "made up"
        )
