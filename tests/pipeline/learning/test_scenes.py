"""Real scenes as examples: which boxes count, and what an incomplete list of signs may teach."""

import json

import cv2
import numpy as np
import pytest

from wayside.pipeline.learning.samples import NEITHER, OFF, ON, FaceLabel
from wayside.pipeline.learning.scenes import (
    read_scenes,
    scene_drive,
    scene_images,
    scene_sources,
)
from wayside.schemas.errors import InputError
from wayside.schemas.settings import Settings

BOX = [300, 215, 330, 245]


@pytest.fixture
def folder(tmp_path):
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    listed = []
    rng = np.random.default_rng(3)
    for name, source, complete in (("b", "two", True), ("a", "two", False), ("c", "one", True)):
        bgr = rng.normal(110, 6, (480, 640, 3)).clip(0, 255).astype(np.uint8)
        bgr[215:245, 300:330] = (40, 30, 180)
        bgr[215:245, 400:430] = (180, 60, 30)
        cv2.imwrite(str(scenes / f"{name}.png"), bgr)
        sign = {"box": BOX, "color": "red", "shape": "rectangle"}
        listed.append(
            {
                "file": f"{name}.png",
                "source_repo": source,
                "complete": complete,
                "signs": [sign],
            }
        )
    (scenes / "scenes.json").write_text(json.dumps(listed))
    return tmp_path


def test_scenes_are_grouped_by_source_in_order_of_names(folder):
    sources = scene_sources(read_scenes(folder))
    assert [(k, [s["file"] for s in v]) for k, v in sources.items()] == [
        ("one", ["c.png"]),
        ("two", ["a.png", "b.png"]),
    ]


def test_images_are_read_as_rgb_with_a_camera_of_their_size(folder):
    image = next(scene_images(folder, read_scenes(folder)))
    assert image.rgb[230, 315].tolist() == [180, 30, 40]
    assert (image.frame.camera.width, image.frame.camera.height) == (640, 480)


def test_boxed_signs_are_faces_and_only_complete_scenes_show_what_is_none(folder):
    scenes = scene_sources(read_scenes(folder))["two"]
    drive = scene_drive(scene_images(folder, scenes), "two", scenes, Settings())
    labels = [set(drive.candidates.label[drive.candidates.frame == k].tolist()) for k in (0, 1)]
    assert labels[0] == {ON, NEITHER}
    assert {ON, OFF} <= labels[1]
    assert drive.signs[0] == FaceLabel("two/a.png/0", "red", "rectangle")
    assert drive.wanted.all()


def test_a_folder_without_scenes_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"scenes\.json"):
        read_scenes(tmp_path)


def test_a_missing_image_is_named(folder):
    (folder / "scenes" / "c.png").unlink()
    with pytest.raises(InputError, match=r"c\.png"):
        list(scene_images(folder, read_scenes(folder)))
